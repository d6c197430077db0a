"""Goodness of fit and status of a model fitted to a campaign.

    chi2 = sum |r|^2                             over the samples of all fit records, or
    chi2 = sum 2/N |R(w)|^2                      over the bins w of a band, R the discrete Fourier transform of r

r is the residual in sigmas with the nuisances removed.  An excess that is concentrated in a band is far more significant there,
because the smallest significant excess, 3 sqrt(2 dof), is smaller for fewer data.

Shapes: N samples, S senses.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft

from ...experiment.record import Campaign
from ..gate import Gate, GoodnessOfFit, Status, status_of
from .fit import CampaignFit


def _error(fit: CampaignFit) -> float:
    error = fit.error["fit"]
    return float("nan") if error is None else error


def full_band_goodness(fit: CampaignFit) -> GoodnessOfFit:
    """Error [1] and chi2 over all samples of the fit records."""
    return GoodnessOfFit(_error(fit), fit.chi2, fit.dof)


def band_goodness(fit: CampaignFit, campaign: Campaign, low_hz: float, high_hz: float) -> GoodnessOfFit:
    """Full-band error [1] of the fit records, and their chi2 in the band low to high [Hz], as in the in-band likelihood."""
    chi2, rows = 0.0, 0
    residuals = {record.name: record.residual for record in fit.records}
    for record in campaign.with_role("fit"):
        residual = residuals[record.name]
        samples = residual.shape[0]
        frequency_hz = np.arange(samples // 2 + 1) * record.sample_rate_hz / samples
        inside = (frequency_hz >= low_hz) & (frequency_hz <= high_hz) & (frequency_hz > 0.0)
        spectrum = rfft(residual, axis=0)[inside]
        chi2 += 2.0 / samples * float(np.sum(np.abs(spectrum) ** 2))
        rows += 2 * spectrum.size
    return GoodnessOfFit(_error(fit), chi2, rows - len(fit.names))


def fit_status(fit: CampaignFit, goodness: GoodnessOfFit | None, gate: Gate) -> tuple[Status, str | None]:
    """Status of a fitted campaign and its reason; ``goodness`` is ``None`` where the gate does not apply."""
    failed = None if fit.fit_ok else "the fit did not converge, or the records do not determine every parameter"
    return status_of(goodness, None if fit.theta_deg is None else fit.theta_deg[1], gate, failed)
