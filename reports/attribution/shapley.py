"""Shapley shares of a variance, for a function of independent groups of standard normals that can be evaluated anywhere.

    x, y ~ N(0, I);  pi: a random order of the g groups;  F_j = f(x with the first j groups of pi taken from y)
    phi_pi(j) = (F_0 - (F_j + F_{j-1}) / 2) (F_{j-1} - F_j),      E phi_k = Shapley value of group k
    sum_k phi_k = (f(x) - f(y))^2 / 2,                            E of it = Var f,      share_k = E phi_k / Var f

A Shapley value gives each interaction to its groups in equal parts, so the shares add up to one whatever f is: a loss (0 or 1) of
many irregularities that only together exceed a limit, too.  Groups must be independent; numbers within a group need not be.

Shapes: N samples, d numbers, g groups, q outputs.
Source: Goda, Reliab. Eng. Syst. Saf. 213 (2021) 107702 (estimator); Owen, SIAM/ASA J. Uncertain. Quantif. 2 (2014) 245 (shares).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from pipeline.arrays import FloatArray, IntArray

from ..interval_estimate import IntervalEstimate
from ..yields import LEVEL


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares (g, q) [1] of the variance of each output, their sd, and the ends of their interval at ``LEVEL``.

    ``mean`` and ``variance`` (q,) are those of the outputs.  A share without information has an infinite sd.
    """

    mean: FloatArray
    variance: FloatArray
    value: FloatArray
    sd: FloatArray
    low: FloatArray
    high: FloatArray


def shapley_shares(
    evaluate: Callable[[FloatArray], FloatArray], group: IntArray, samples: int, seed: int, batch: int = 1000
) -> Shares:
    """Shares of the groups in the variance of each output.

    Parameters
    ----------
    evaluate : outputs (N, q) of standard normals (N, d).
    group : (d,) group of each number, 0 .. g - 1.
    samples : N; the function is evaluated N (g + 1) times.
    seed : of the samples.
    batch : samples that are evaluated together.
    """
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    phi, mean = [], []
    for first in range(0, samples, batch):
        count = min(batch, samples - first)
        values, at_x = _exchanged(evaluate, group, count, random)
        phi.append(values)
        mean.append(at_x)
    return _ratio(np.concatenate(phi), np.concatenate(mean))


def halved_change(
    evaluate: Callable[[FloatArray], FloatArray], group: IntArray, which: int, x: FloatArray, at_x: FloatArray
) -> IntervalEstimate:
    """Change of the mean of the first output if the numbers of group ``which`` were half as large.

    Parameters
    ----------
    x, at_x : samples (N, d) and the first output there (N,): the change is that of the same devices.
    """
    change = evaluate(np.where(group == which, 0.5 * x, x))[:, 0] - at_x
    value, sd = float(change.mean()), float(change.std(ddof=1) / np.sqrt(change.size))
    # Where no device changes: the rule of three.  Hanley, Lippman-Hand, JAMA 249 (1983) 1743.
    half = float(ndtri(0.5 * (1.0 + LEVEL))) * sd if sd > 0.0 else 3.0 / change.size
    return IntervalEstimate(value, sd, value - half, value + half)


def _exchanged(
    evaluate: Callable[[FloatArray], FloatArray], group: IntArray, count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """phi (N, g, q) and f(x) (N, q) of ``count`` samples."""
    x, y = random.standard_normal((2, count, group.size))
    groups = int(group.max()) + 1
    order = random.permuted(np.broadcast_to(np.arange(groups), (count, groups)), axis=1)
    rank = np.argsort(order, axis=1)
    start = evaluate(x)
    before = start
    phi = np.empty((count, groups, start.shape[1]))
    for step in range(groups):
        now = evaluate(np.where(rank[:, group] <= step, y, x))
        phi[np.arange(count), order[:, step]] = (start - 0.5 * (now + before)) * (before - now)
        before = now
    return phi, start


def _ratio(phi: FloatArray, at_x: FloatArray) -> Shares:
    """The ratio of means and its sd by linearization: sd(phi_k - share_k V) / (sqrt(N) mean V)."""
    count = len(phi)
    whole = phi.sum(axis=1)
    variance = whole.mean(axis=0)
    known = variance > 0.0
    scale = np.where(known, variance, 1.0)
    value = np.where(known, phi.mean(axis=0) / scale, np.nan)
    residual = phi - value * whole[:, None]
    sd = np.where(known, residual.std(axis=0, ddof=1) / (np.sqrt(count) * scale), np.inf)
    half = float(ndtri(0.5 * (1.0 + LEVEL))) * sd
    return Shares(at_x.mean(axis=0), variance, value, sd, value - half, value + half)
