"""Shapley shares of a variance from stored devices alone: what was drawn and what came out, without a model between them.

    y = sum_a c_a psi_a(z) + rest,   psi: normalized Hermite polynomials of degree 1 to 4 of one number, products z_i z_j of two
    c_a = E[y psi_a],   V_a = c_a^2,   share of a group = (V of its own terms + half of V of products with other groups) / Var y

Devices of a lot share numbers, so pairs of devices from different lots alone estimate c_a^2 without bias:

    c_a^2 = [(sum_l S_l)^2 - sum_l S_l^2] / (N^2 - sum_l n_l^2),   S_l = sum over lot l of (y - mean) psi_a(z)

sd: delete-one-lot jackknife; interval: Student's t with lots - 1 degrees of freedom.  The shares leave out the noise of the
measurement and what needs higher terms (much of a 0/1 loss): that part is 1 - sum of the shares, the ``rest``.

Shapes: N devices in L lots, d numbers, g groups.
Source: Sudret, Reliab. Eng. Syst. Saf. 93 (2008) 964 (variance from polynomial terms); Hoeffding, Ann. Math. Stat. 19 (1948) 293
(U-statistics); Owen 2014 (Shapley values of these terms).
"""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import UsageError

from ..yields import LEVEL
from .shapley import Shares

#: With fewer lots the shares of lots have an sd above 0.2 and their intervals do not hold (tests/reports/attribution).
LEAST_LOTS = 20
_DEGREES = 4
#: More lots than this are merged: the sd does not gain, and the sums of a lot take 40 kB per output.
_MOST_LOTS = 400


def given_data_shares(z: FloatArray, group: IntArray, lot: IntArray, y: FloatArray) -> Shares:
    """Shares of the groups and of the rest, last, in the variance of each output: arrays (g + 1, q).

    Parameters
    ----------
    z : (N, d) numbers with mean 0 and variance 1, uncorrelated.
    group : (d,) group of each number, 0 .. g - 1.
    lot : (N,) lot of each device, 0 .. L - 1.
    y : (N, q) outputs.

    Raises
    ------
    UsageError : fewer than ``LEAST_LOTS`` lots.
    """
    lots = int(lot.max()) + 1 if lot.size else 0
    if lots < LEAST_LOTS:
        raise UsageError(
            "too few lots to attribute a variance from stored devices",
            value=lots,
            allowed=f"{LEAST_LOTS} lots or more",
            next_step="run more devices: lots follow one another in device numbers",
        )
    # Lots are independent, so that several of them may be treated as one.
    merged = lot % _MOST_LOTS
    order = np.argsort(merged, kind="stable")
    z, y, size = z[order], y[order], np.bincount(merged)
    found = [_one(z, group, size, y[:, k]) for k in range(y.shape[1])]
    mean, variance, value, sd = (np.stack(part, axis=-1) for part in zip(*found))
    half = float(stdtrit(size.size - 1.0, 0.5 * (1.0 + LEVEL))) * sd
    return Shares(mean, variance, value, sd, value - half, value + half)


def _one(z: FloatArray, group: IntArray, size: IntArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Mean, variance, shares (g + 1,) and their sd of one output; devices sorted by lot."""
    lots, d = size.size, z.shape[1]
    last = np.cumsum(size)
    centred = y - y.mean()
    of_one, of_two = np.empty((lots, _DEGREES, d)), np.empty((lots, d, d))
    for k, rows in enumerate(slice(end - n, end) for n, end in zip(size.tolist(), last.tolist())):
        own, out = z[rows], centred[rows]
        of_one[k] = [out @ term for term in _hermite(own)]
        of_two[k] = np.triu(own.T @ (out[:, None] * own), 1)
    one, two = _LotSums(of_one, size), _LotSums(of_two, size)
    offset = _LotSums(np.add.reduceat(centred, last - size), size)
    square = np.add.reduceat(centred**2, last - size)
    member = np.zeros((int(group.max()) + 1, d))
    member[group, np.arange(d)] = 1.0

    def variance(without: int | None) -> float:
        left = float(offset.devices(without))
        return (float(square.sum()) - (0.0 if without is None else float(square[without]))) / left - float(
            offset.squared(without)
        )

    def shares(without: int | None) -> FloatArray:
        pairs = member @ two.squared(without) @ member.T
        # Of a product within a group both halves are its own.
        own = member @ one.squared(without).sum(axis=0) + 0.5 * (pairs + pairs.T).sum(axis=1)
        value = own / variance(without)
        return np.append(value, 1.0 - value.sum())

    whole = np.array(variance(None))
    if not whole > 0.0 or any(not variance(k) > 0.0 for k in range(lots)):
        unknown = np.full(len(member) + 1, np.nan)
        return np.array(y.mean()), whole, unknown, np.full_like(unknown, np.inf)
    each = np.array([shares(k) for k in range(lots)])
    sd = np.sqrt((lots - 1.0) / lots * np.sum((each - each.mean(axis=0)) ** 2, axis=0))
    return np.array(y.mean()), whole, shares(None), sd


class _LotSums:
    """Sums S_l (L, ..) over the devices of each lot, and the squares of their means from pairs of lots."""

    def __init__(self, sums: FloatArray, size: IntArray) -> None:
        self.sums, self.size = sums, size.astype(np.float64)
        self.total, self.squares = sums.sum(axis=0), (sums * sums).sum(axis=0)

    def devices(self, without: int | None) -> float:
        """Devices of all lots but one."""
        return float(self.size.sum()) - (0.0 if without is None else float(self.size[without]))

    def squared(self, without: int | None) -> FloatArray:
        """(E S / n)^2 without bias, from all lots but ``without``."""
        total, squares, same = self.total, self.squares, float(self.size @ self.size)
        if without is not None:
            total, squares = total - self.sums[without], squares - self.sums[without] ** 2
            same -= float(self.size[without]) ** 2
        return np.asarray((total * total - squares) / (self.devices(without) ** 2 - same))


def _hermite(z: FloatArray) -> tuple[FloatArray, ...]:
    """Normalized Hermite polynomials He_1 .. He_4 of z, each of its shape."""
    square = z * z
    return (
        z,
        (square - 1.0) / np.sqrt(2.0),
        (square - 3.0) * z / np.sqrt(6.0),
        ((square - 6.0) * square + 3.0) / np.sqrt(24.0),
    )
