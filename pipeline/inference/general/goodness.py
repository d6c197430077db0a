"""Goodness of fit and status of a model fitted to a campaign.

    chi2 = sum |r|^2                             over the samples of all fit records, or
    chi2 = sum 2/N |R(w)|^2                      over the bins w of a band, R the discrete Fourier transform of r

r is the residual in sigmas with the nuisances removed.  An excess that is concentrated in a band is far more significant there,
because the smallest significant excess, 3 sd(chi2), is smaller for fewer data:

    var chi2 = 2 dof + 2 dof^2 / nu                  nu: degrees of freedom of the noise level

Shapes: N samples, S senses.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft

from ...experiment.record import Campaign
from ..gate import LOUDER, Gate, GoodnessOfFit, Status, status_of
from .fit import CampaignFit
from .resonances import resonance_excess
from .starts import driven_band


def _error(fit: CampaignFit) -> float:
    error = fit.error["fit"]
    return float("nan") if error is None else error


def _chi2_sd(fit: CampaignFit, dof: int) -> float:
    """sd of chi2: of the residual, and of a noise level that is known with few degrees of freedom."""
    return float(np.sqrt(2.0 * dof + 2.0 * dof**2 / fit.noise.dof))


def full_band_goodness(fit: CampaignFit) -> GoodnessOfFit:
    """Error [1] and chi2 over all samples of the fit records."""
    return GoodnessOfFit(_error(fit), fit.chi2, fit.dof, _chi2_sd(fit, fit.dof))


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
    dof = rows - len(fit.names)
    return GoodnessOfFit(_error(fit), chi2, dof, _chi2_sd(fit, dof))


def structured_misfit(fit: CampaignFit, campaign: Campaign, gate: Gate | None = None) -> str | None:
    """Why the residual of the fit records is no noise: it is concentrated at the resonances, whatever its level, or above the
    noise that a local fit leaves on the same records.  Else ``None``.

    compare, refine and identify all ask this.  With an unknown noise level and records held out, those judge instead: an unknown
    level is that of a record whose distortion is everywhere, so that a small share of it at the resonances says nothing.
    """
    if not fit.noise.known and fit.of_role("validate"):
        return None
    gate = gate or Gate()
    if fit.noise.source == "local" and not _error(fit) <= gate.error_max:
        return (
            f"the residual is {_error(fit):.3g} times the noise that a smooth local fit leaves: run gyroscreen diagnose"
        )
    found = resonance_excess(fit, campaign)
    if found.p_value >= gate.alpha:
        return None
    return (
        f"the residual is {found.ratio:.3g} times as dense at the resonances as beside them (p = {found.p_value:.2g}):"
        " run gyroscreen diagnose"
    )


def fit_status(
    fit: CampaignFit, campaign: Campaign, goodness: GoodnessOfFit | None, gate: Gate
) -> tuple[Status, str | None]:
    """Status of a fitted campaign and its reason; ``goodness`` is ``None`` where the gate does not apply."""
    failed = None if fit.fit_ok else "the fit did not converge, or the records do not determine every parameter"
    status, reason = status_of(goodness, None if fit.theta_deg is None else fit.theta_deg[1], gate, failed)
    if status == "ok" and (misfit := structured_misfit(fit, campaign, gate)) is not None:
        return "misfit", misfit
    loud = status == "misfit" and goodness is not None and not goodness.error <= gate.error_max
    if loud and structured_misfit(fit, campaign, gate) is None:
        reason = f"{reason}; the residual is as dense beside the resonances as at them: {LOUDER}"
    return status, reason


def campaign_status(
    fit: CampaignFit, campaign: Campaign, gate: Gate | None = None, band_hz: tuple[float, float] | None = None
) -> tuple[Status, str | None]:
    """The status that identify and compare give a fit, and its reason.

    For a gyro the data of the band [low, high] Hz are judged, as in the in-band path, so that both paths agree; without a band,
    or with a mode outside of it, those of the driven band.
    """
    if not fit.noise.known:
        goodness = None
    elif fit.model.plant.kind == "gyro":
        if band_hz is None or not all(
            band_hz[0] < fit.values[name] < band_hz[1] for name in ("f1_hz", "f2_hz", "f3_hz") if name in fit.values
        ):
            band_hz = driven_band(campaign.with_role("fit"))
        goodness = band_goodness(fit, campaign, *band_hz)
    else:
        goodness = full_band_goodness(fit)
    return fit_status(fit, campaign, goodness, gate or Gate())
