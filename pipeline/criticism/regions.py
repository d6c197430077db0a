"""Where a model fails: the share of the excess misfit in each region, and spectral lines, both tested against noise.

    excess_i = chi2_i - dof_i
    share_i  = max(excess_i, 0) / sum over the family of max(excess_j, 0)
    error_i  = sqrt(chi2_i / dof_i)                                                 rms of the residual [sigma]

A region is significant if its energy is improbable under noise at ``ALPHA`` among all regions (Bonferroni).  A line is a single
frequency whose energy exceeds the noise of its neighbourhood:

    q_k = chi2_k / max(1, median over the neighbours of chi2 / median of chi2_d)    ~ chi2_d under noise alone

Coloured or underestimated noise raises the neighbours as well and leaves q unchanged; a line raises only its own bin.
Shapes: M bins of a spectrum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from ..arrays import FloatArray
from .budget import ALPHA
from .problem import Region, Spectrum
from .significance import log_any, log_tail

#: Neighbouring bins that determine the background of a bin.
_NEIGHBOURS = 101
#: Largest number of lines of one spectrum.
_MOST_LINES = 40


@dataclass(frozen=True)
class RegionShare:
    """A region, its share of the excess of its family, its error [sigma], and the family-wise p-value of its energy."""

    family: str
    labels: Mapping[str, object]
    share: float
    error: float
    p_value: float


def region_shares(
    regions: Sequence[Region], alpha: float = ALPHA, noise_dof: float = np.inf
) -> tuple[RegionShare, ...]:
    """Regions with significantly more energy than noise, the largest share first.

    Parameters
    ----------
    regions : of any families; shares sum to one within a family.
    alpha : family-wise significance level; infinite for all regions.
    noise_dof : degrees of freedom of the noise level; the p-value then accounts for its uncertainty by the effective
        1 / (1/dof + 1/noise_dof).
    """
    used = [region for region in regions if region.dof > 0.0]
    totals: dict[str, float] = {}
    for region in used:
        totals[region.family] = totals.get(region.family, 0.0) + max(region.chi2 - region.dof, 0.0)
    found = []
    for region in used:
        dof = 1.0 / (1.0 / region.dof + 1.0 / noise_dof)
        p = float(np.exp(log_any(log_tail(region.chi2 * dof / region.dof, max(round(dof), 1)), len(used))))
        if p >= alpha:
            continue
        share = max(region.chi2 - region.dof, 0.0) / max(totals[region.family], 1e-300)
        error = float(np.sqrt(region.chi2 / region.dof))
        found.append(RegionShare(region.family, region.labels, float(share), error, p))
    return tuple(sorted(found, key=lambda item: -item.share))


def explained_share(excess_before: float, excess_after: float) -> float:
    """1 - excess after / excess before: the share of a misfit that a new model explains; 0 where there was none.

    It exceeds 1 where noise leaves less energy than its expectation.
    """
    return 1.0 - excess_after / excess_before if excess_before > 0.0 else 0.0


def explained_by_region(
    before: Sequence[Region], after: Sequence[Region], alpha: float = ALPHA
) -> tuple[tuple[RegionShare, float], ...]:
    """Every significant region of ``before`` with the ``explained_share`` of its excess in ``after``."""
    new = {_key(region.family, region.labels): region for region in after}
    pairs = []
    for item in region_shares(before, alpha):
        region = new.get(_key(item.family, item.labels))
        if region is not None:
            excess = (item.error**2 - 1.0) * region.dof
            pairs.append((item, explained_share(excess, region.chi2 - region.dof)))
    return tuple(pairs)


def description(region: Region) -> str:
    """A region in words: its family, then its labels."""
    return f"{region.family}, " + ", ".join(_label_text(name, value) for name, value in region.labels.items())


def _label_text(name: str, value: object) -> str:
    stem, _, unit = name.rpartition("_")
    units = {"hz": "Hz", "s": "s", "v": "V"}
    if isinstance(value, list | tuple):
        return " to ".join(f"{end:.5g}" for end in value) + f" {units.get(unit, '')}".rstrip()
    if isinstance(value, float):
        return f"{stem or name} {value:.5g}"
    return str(value) if isinstance(value, str) else f"{name.replace('_', ' ')} {value}"


def _key(family: str, labels: Mapping[str, object]) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Identifies the same region in the residuals of two models."""
    return family, tuple(sorted((name, str(value)) for name, value in labels.items()))


def normalized_energy(spectrum: Spectrum) -> FloatArray:
    """q_k (M,): energies in units of the background level of their neighbourhood, or of the noise if that is higher."""
    size = min(_NEIGHBOURS, spectrum.chi2.size)
    background = median_filter(spectrum.chi2, size=size, mode="reflect") / chdtri(spectrum.dof, 0.5)
    return np.asarray(spectrum.chi2 / np.maximum(background, 1.0))


def lines_in(spectrum: Spectrum, excluded_hz: Sequence[tuple[float, float]]) -> list[float]:
    """Frequencies [Hz] of the lines of a spectrum, ascending, outside the bands ``excluded_hz`` [Hz]."""
    chi2, frequency = spectrum.chi2, spectrum.frequency_hz
    # Bonferroni: one spectrum of noise has a line with probability ALPHA.
    peak = log_tail(normalized_energy(spectrum), spectrum.dof) < np.log(ALPHA / chi2.size)
    peak[1:-1] &= (chi2[1:-1] >= chi2[:-2]) & (chi2[1:-1] >= chi2[2:])
    peak[0] = peak[-1] = False
    for low, high in excluded_hz:
        peak &= (frequency < low) | (frequency > high)
    found = np.flatnonzero(peak)
    found = found[np.argsort(-chi2[found])][:_MOST_LINES]
    width = float(frequency[1] - frequency[0])
    return sorted(float(frequency[k]) + _interpolated(chi2, int(k)) * width for k in found)


def pooled_spectra(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """One spectrum (M,) per frequency grid: the sum of those that share it."""
    by_grid: dict[bytes, list[Spectrum]] = {}
    for one in spectra:
        by_grid.setdefault(one.frequency_hz.tobytes(), []).append(one)
    return [
        Spectrum(own[0].frequency_hz, np.sum([one.chi2 for one in own], axis=0), sum(one.dof for one in own))
        for own in by_grid.values()
    ]


def _interpolated(energy: FloatArray, k: int) -> float:
    """Vertex [bins from k] of the parabola through the logarithms of peak ``k`` and its two neighbours."""
    a, b, c = np.log(energy[k - 1 : k + 2] + 1e-300)
    curvature = a - 2.0 * b + c
    return float(np.clip(0.5 * (a - c) / curvature, -0.5, 0.5)) if curvature < 0.0 else 0.0
