"""Where a model fails: the share of the excess misfit in each region, tested against noise.

    excess_i = chi2_i - dof_i
    share_i  = max(excess_i, 0) / sum over the family of max(excess_j, 0)
    error_i  = sqrt(chi2_i / dof_i)                                              rms of the residual [sigma]

A region is significant if its energy is improbable under noise at ``ALPHA`` among all regions (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .problem import Region
from .significance import log_any, log_tail

#: Family-wise probability that noise alone makes a region significant.
ALPHA = 0.003


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
