"""Whether a misfit is concentrated at the resonances, which shows even where nothing measures the noise.

    F = [E_near / n_near] / [E_away / n_away]  ~  F(n_near, n_away)

E is the energy of the residual and n the number of its real Fourier coefficients: near a resonance, within ten of its half-widths
or three bins; away from them, in the rest of the driven band.  A common noise level cancels.  The fitted parameters take their
degrees of freedom mostly from E_near, so F is conservative.

Shapes: N samples, S senses.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft
from scipy.special import fdtrc

from ...experiment.record import Campaign
from .fit import CampaignFit
from .free_disturbances import SPREAD_BINS
from .starts import excited_band

#: Half-widths on either side that belong to a resonance.
HALF_WIDTHS = 10.0


def resonances_of(values: Mapping[str, float]) -> tuple[tuple[float, float], ...]:
    """(f, zeta f) [Hz] of each mode of the plant, ascending; ``values`` are the parameters of a fitted model."""
    modes = [(values[n], values.get(f"zeta{n[1:-3]}", 0.0) * values[n]) for n in values if re.fullmatch(r"f\d*_hz", n)]
    return tuple(sorted((float(f), float(half_width)) for f, half_width in modes if f > 0.0))


@dataclass(frozen=True)
class ResonanceExcess:
    """F, the density of the residual at the resonances relative to that beside them, and its p-value."""

    ratio: float
    p_value: float


def resonance_excess(fit: CampaignFit, campaign: Campaign) -> ResonanceExcess:
    """F over all fit records and channels; 1 where no bin of the driven band is near, or none is away from, a resonance."""
    fitted = campaign.with_role("fit")
    low_hz, high_hz = excited_band(fitted)
    residuals = {record.name: record.residual for record in fit.records}
    energy, rows = np.zeros(2), np.zeros(2)
    for record in fitted:
        residual = residuals[record.name]
        samples = residual.shape[0]
        f = np.arange(samples // 2 + 1) * record.sample_rate_hz / samples
        reach = SPREAD_BINS * record.sample_rate_hz / samples
        near = np.zeros(f.size, dtype=np.bool_)
        for mode, half_width in resonances_of(fit.values):
            near |= np.abs(f - mode) <= max(HALF_WIDTHS * half_width, reach)
        inside = (f >= low_hz) & (f <= high_hz) & (f > 0.0)
        power = 2.0 / samples * np.sum(np.abs(rfft(residual, axis=0)) ** 2, axis=1)
        for i, part in enumerate((inside & near, inside & ~near)):
            energy[i] += float(power[part].sum())
            rows[i] += 2.0 * float(part.sum()) * residual.shape[1]
    if not rows.all() or energy[1] <= 0.0:
        return ResonanceExcess(1.0, 1.0)
    density = energy / rows
    ratio = float(density[0] / density[1])
    return ResonanceExcess(ratio, float(fdtrc(rows[0], rows[1], ratio)))
