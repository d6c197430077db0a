"""Where a model fails: the share of the excess misfit in each region, with an honest null.

    excess_i = chi2_i / level - dof_i,     sd(excess_i) = sqrt(2 dof_i) where the noise alone is left
    share_i  = max(excess_i, 0) / sum over the family of max(excess_j, 0)
    error_i  = sqrt(chi2_i / dof_i)

A region is significant when its energy is improbable at ``alpha`` among all regions (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .problem import Region
from .tails import log_any, log_tail


@dataclass(frozen=True)
class Where:
    """One region: its labels, its share of the family's excess, its error, and the family-wise p of its energy."""

    family: str
    labels: Mapping[str, object]
    share: float
    error: float
    p_value: float


def where(regions: Sequence[Region], alpha: float = 0.003, noise_dof: float = np.inf) -> tuple[Where, ...]:
    """Regions that are significantly above the noise, the largest share first.

    ``noise_dof``: degrees of freedom behind the noise level; a region that is larger than that is judged by what the level
    is known to, 1 / (1/dof + 1/noise_dof).
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
        found.append(Where(region.family, region.labels, float(share), error, p))
    return tuple(sorted(found, key=lambda item: -item.share))


def place(region: Region) -> str:
    """Where a region lies, in plain words: family, then its labels."""
    return f"{region.family}, " + ", ".join(_told(name, value) for name, value in region.labels.items())


def _told(name: str, value: object) -> str:
    stem, _, unit = name.rpartition("_")
    units = {"hz": "Hz", "s": "s", "v": "V"}
    if isinstance(value, list | tuple):
        return " to ".join(f"{end:.5g}" for end in value) + f" {units.get(unit, '')}".rstrip()
    if isinstance(value, float):
        return f"{stem or name} {value:.5g}"
    return str(value) if isinstance(value, str) else f"{name.replace('_', ' ')} {value}"


def explained(
    before: Sequence[Region], after: Sequence[Region], alpha: float = 0.003
) -> tuple[tuple[Where, float], ...]:
    """For every region that was significant before: the share of its excess that a new model took away (1 is all)."""
    left = {(region.family, _key(region)): region for region in after}
    pairs = []
    for item in where(before, alpha):
        key = (item.family, tuple(sorted((k, str(v)) for k, v in item.labels.items())))
        region = left.get(key)
        if region is None:
            continue
        first = (item.error**2 - 1.0) * region.dof
        pairs.append((item, 1.0 - (region.chi2 - region.dof) / first if first > 0.0 else 0.0))
    return tuple(pairs)


def _key(region: Region) -> tuple[tuple[str, str], ...]:
    return tuple(sorted((k, str(v)) for k, v in region.labels.items()))
