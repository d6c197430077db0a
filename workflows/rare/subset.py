"""Subset simulation: devices that a population makes very rarely, found level by level.

    P(g > 0) = P(g > b_1) P(g > b_2 | g > b_1) ...,   each level the ``SHARE`` of devices with the largest g of the one before

Devices of a level are moved by conditional sampling, which leaves N(0, I) invariant, and a move that falls below the level is
refused:

    z' = sqrt(1 - s^2) z + s n,   n ~ N(0, I),   s adapted to ``ACCEPTED`` accepted moves

Shapes: B devices, d latent normals.
Source: Au, Beck, Probabilistic Engineering Mechanics 16 (2001) 263; Papaioannou, Betz, Zwirglmaier, Straub, Probabilistic
Engineering Mechanics 41 (2015) 89 (conditional sampling, its adaptation).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray

#: z (B, d) -> g (B,); a device is lost where g > 0.
Response = Callable[[FloatArray], FloatArray]

SHARE = 0.1
ACCEPTED = 0.44
#: Below this probability nothing is sought.
FLOOR = 1e-9
#: A level that most devices reach is a plateau of g, on which there is no way to go.
_PLATEAU = 0.5
#: Median of chi2 with one degree of freedom.
_MEDIAN_CHI2 = 0.4549


@dataclass(frozen=True, eq=False)
class Subset:
    """What was found.

    Parameters
    ----------
    lost : z (n, d) of lost devices, nearly from N(0, I) given g > 0; empty if none was found.
    probability : P(g > 0), or the probability of the last level where none was found.
    relative_sd : of ``probability``; nan where none was found.
    independent : number of independent devices that ``lost`` is worth.
    devices : evaluations of g.
    plateau : whether the search ended because g does not change.
    """

    lost: FloatArray
    probability: float
    relative_sd: float
    independent: float
    devices: int
    plateau: bool


@dataclass(frozen=True, eq=False)
class _Chains:
    """Chains of a level: z (steps, chains, d), g (steps, chains), next step size."""

    z: FloatArray
    g: FloatArray
    step: float


def search(response: Response, z: FloatArray, g: FloatArray, most: int, random: np.random.Generator) -> Subset:
    """Find lost devices with at most ``most`` devices in levels of n, the first of which is ``z`` (n, d) with ``g`` (n,)."""
    n, dimension = z.shape
    probability, variance, devices, step = 1.0, 0.0, 0, 0.6
    level = _Chains(z[None], g[None], step)
    while True:
        flat = level.g.ravel()
        threshold = min(float(np.partition(flat, -round(SHARE * n))[-round(SHARE * n)]), 0.0)
        above = level.g > 0.0 if threshold == 0.0 else level.g >= threshold
        share = float(np.mean(above))
        if share == 0.0 or (threshold < 0.0 and share > _PLATEAU):
            return Subset(np.empty((0, dimension)), probability, math.nan, 0.0, devices, True)
        correlation = _correlation(above)
        probability *= share
        variance += (1.0 - share) / (share * flat.size) * (1.0 + correlation)
        if threshold < 0.0 and (probability < FLOOR or devices + 2 * n > most):
            return Subset(np.empty((0, dimension)), probability, math.nan, 0.0, devices, False)
        seeds = random.permutation(np.argwhere(above))
        # Chains of equal length; a few seeds of the largest levels are left out.
        chains = min(len(seeds), max(round(SHARE * n), 2))
        steps = max(n // chains, 2)
        chosen = seeds[:chains]
        level = _moved(
            response, level.z[chosen[:, 0], chosen[:, 1]], level.g[chosen[:, 0], chosen[:, 1]], threshold, steps,
            level.step, random,
        )  # fmt: skip
        devices += chains * (steps - 1)
        if threshold == 0.0:
            found = level.z.reshape(-1, dimension)
            return Subset(found, probability, math.sqrt(variance), _independent(found, chains), devices, False)


def _moved(
    response: Response,
    z: FloatArray,
    g: FloatArray,
    threshold: float,
    steps: int,
    step: float,
    random: np.random.Generator,
) -> _Chains:
    """Chains of ``steps`` devices above ``threshold`` from the seeds ``z`` (chains, d) with ``g`` (chains,)."""
    all_z, all_g = [z], [g]
    for k in range(1, steps):
        moved = math.sqrt(1.0 - step * step) * z + step * random.standard_normal(z.shape)
        found = response(moved)
        accepted = found > 0.0 if threshold == 0.0 else found >= threshold
        z, g = np.where(accepted[:, None], moved, z), np.where(accepted, found, g)
        all_z.append(z)
        all_g.append(g)
        # Robbins-Monro with the weights of the source.
        step = min(1.0, step * math.exp((float(np.mean(accepted)) - ACCEPTED) / math.sqrt(k)))
    return _Chains(np.stack(all_z), np.stack(all_g), step)


def _independent(z: FloatArray, chains: int) -> float:
    """Number of independent devices that z (n, d) of ``chains`` chains is worth.

    Chains have common ancestors.  A latent normal without influence has a mean of variance 1/m, and the median of m mean^2 over
    such is that of chi2 with one degree of freedom.  Where most latent normals have influence this counts too few, so it is
    bounded from below.
    """
    square = float(np.median(np.mean(z, axis=0) ** 2))
    return min(max(_MEDIAN_CHI2 / max(square, 1e-300), chains / 10.0), float(chains))


def _correlation(above: BoolArray) -> float:
    """gamma of Au and Beck: 2 sum_k (1 - k/steps) rho_k of the indicators (steps, chains) along their chains."""
    steps = len(above)
    share = float(np.mean(above))
    spread = share * (1.0 - share)
    if steps < 2 or spread == 0.0:
        return 0.0
    x = above - share
    rho = [float(np.mean(x[k:] * x[:-k])) / spread for k in range(1, steps)]
    return max(2.0 * sum((1.0 - k / steps) * r for k, r in enumerate(rho, start=1)), 0.0)
