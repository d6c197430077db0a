"""Signatures of scanned effects, which are the same for all devices: an additional mode at many frequencies, mains lines.

    mode (f, zeta):   y_a = sum_d M_ad {p/(p - p~) Phi(w; p) + conj}_d        M free: four columns (two channels, two drives)
    line f:           y_a = A_a cos + B_a sin                                  four columns (two channels, cos and sin)

With a free matrix M the score is that of a mode of rank two, which contains the rank one of the effect.

Each point of a scan has two columns per channel, so products with a device are one product with all columns.  The scan of an
effect is one test: p = 1 - (1 - p_least)^points.  A mode that coincides with a resonance of the device looks like a change of its
residue, which no record can tell; the bound therefore holds for 95 % of the logarithmic range of the frequency.

Shapes: W bins, D = 2 drives, g points, P parameters.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from hashlib import sha256
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ....arrays import FloatArray, RealArray
from ....device.effect import Effect
from ..compressed import line_columns, lines_between
from ..inband import SHORT, Band, features
from .blocked import Blocked, blocked
from .library import members_of, scored_effects

#: Damping ratios of a mode, and step of its frequency in units of its damping: half-way to the next point a mode shares 64 % of
#: its energy with either.
_ZETAS, _STEP = (3e-3, 1e-2), 3.0
#: Relative step of the frequency outside of the band, where the response is smooth.
_OUTSIDE = 0.1

#: Columns of a tile of products in single precision.
_TILE = 16
#: Numbers of a column that are made at once, for records whose scans are not kept: 8 MB.
_AT_ONCE = 2**20


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """Points of the scan of one effect.

    Parameters
    ----------
    effect : its name.
    points : their number g.
    weight : (g,) share of each point in the range of the scan; (0,): the bound holds for all points.
    reach : largest strength of a column.
    """

    effect: str
    points: int
    weight: FloatArray
    reach: float


@dataclass(frozen=True, eq=False)
class BandScan:
    """Columns of g points of scans in a band, scan after scan; the weights of a scan need not add up to 1.

    Parameters
    ----------
    scans : the points of each scan, g in all.
    columns : (2 g, 2 W) real, two for each point; in single precision, as products with them are scores of at most 1e7 sigmas.
    sums : (3 g,) products of the two columns of a point, 11, 12, 22, summed over the bins.
    blocks : the columns as mixtures of few, the first of all points before the second ones, if they are kept.
    """

    scans: tuple[ScanPoints, ...]
    columns: NDArray[np.float32]
    sums: FloatArray
    blocks: Blocked | None = None

    def products(self, rows: RealArray, single: Callable[[], NDArray[np.float32]]) -> NDArray[np.float32]:
        """Products (n, g, 2) of the ``rows`` (n, 2 W) with the columns; ``single``: whole tiles of them (>= n, 2 W)."""
        if self.blocks is not None:
            return self.blocks.products(rows).reshape(rows.shape[0], 2, -1).swapaxes(1, 2)
        # This way round takes three quarters of the time.
        return (self.columns @ single().T).T[: rows.shape[0]].reshape(rows.shape[0], -1, 2)

    def weighted_sums(self, power: FloatArray) -> FloatArray:
        """``sums`` (S, 3 g) with the weights ``power`` (S, 2 W) of the bins."""
        return _sums(self.columns, power)


def _sums(columns: RealArray, power: FloatArray) -> FloatArray:
    """Products 11, 12, 22 (S, 3 g) of pairs of columns (2 g, 2 W), summed over the bins with weights (S, 2 W)."""
    first, second = columns[::2], columns[1::2]
    pairs = ((first, first), (first, second), (second, second))
    return np.stack([power @ (a * b).T for a, b in pairs], axis=2).reshape(power.shape[0], -1)


def _band_scan(scan: ScanPoints, columns: FloatArray) -> BandScan:
    single = np.ascontiguousarray(columns.T, dtype=np.float32)
    return BandScan((scan,), single, _sums(columns.T, np.ones((1, columns.shape[0])))[0])


def _together(parts: Sequence[BandScan]) -> BandScan:
    """All parts as one, so that products with a device are one product."""
    return BandScan(
        _joined([scan for part in parts for scan in part.scans]),
        np.concatenate([part.columns for part in parts]),
        np.concatenate([part.sums for part in parts]),
    )


def _joined(scans: Sequence[ScanPoints]) -> tuple[ScanPoints, ...]:
    """The scan of each effect from its parts, which follow each other, with weights that add up to 1."""
    out = []
    for effect, own in groupby(scans, key=lambda scan: scan.effect):
        parts = list(own)
        weight = np.concatenate([part.weight for part in parts])
        points = sum(part.points for part in parts)
        out.append(ScanPoints(effect, points, weight / weight.sum() if weight.size else weight, parts[0].reach))
    return tuple(out)


def _mode_points(inside: tuple[float, float], low_hz: float, high_hz: float) -> list[tuple[float, float, float]]:
    """(f [Hz], zeta, share of the logarithmic range) of the points: dense in the band, sparse elsewhere."""
    points = []
    for zeta in _ZETAS:
        for low, high, step in (
            (low_hz, inside[0], _OUTSIDE),
            (max(low_hz, inside[0]), min(high_hz, inside[1]), _STEP * zeta),
            (inside[1], high_hz, _OUTSIDE),
        ):
            if low >= high or (step == _OUTSIDE and zeta != _ZETAS[-1]):
                continue
            edges = np.geomspace(low, high, int(np.ceil(np.log(high / low) / step)) + 1)
            share = float(np.log(edges[1] / edges[0])) * (1.0 if step == _OUTSIDE else 1.0 / len(_ZETAS))
            points += [(float(f), zeta, share) for f in np.sqrt(edges[1:] * edges[:-1])]
    return points


def _mode_scans(effect: Effect, band: Band, edges_hz: tuple[float, float], most: int) -> Iterator[BandScan]:
    assert effect.resonance is not None
    members = {member.name: member for member in members_of(effect)}
    frequency = members[effect.resonance[0]]
    low, high = frequency.typical or (frequency.low, frequency.high)
    reach = max((member.typical or (member.low, member.high))[1] for member in members.values() if not member.grid)
    points = _mode_points(edges_hz, low, high)
    for first in range(0, len(points), most):
        columns = []
        for f, zeta, _ in points[first : first + most]:
            omega = 2.0 * np.pi * f
            pole = complex(-zeta * omega, omega * np.sqrt(1.0 - zeta**2))
            gain = pole / (pole - np.conj(pole))
            y = gain * features(band, pole) + np.conj(gain) * features(band, pole.conjugate())
            columns.append(np.concatenate([y.real, y.imag], axis=1))
        weight = np.array([share for *_, share in points[first : first + most]])
        yield _band_scan(ScanPoints(effect.name, weight.size, weight, reach), np.concatenate(columns).T)


def _line_scans(
    effect: Effect,
    band: Band,
    edges_hz: tuple[float, float],
    line_hz: float | None,
    most: int,
) -> Iterator[BandScan]:
    frequency = next(member for member in members_of(effect) if member.name == effect.mains_frequency)
    lines = np.concatenate([np.zeros(0), *(lines_between(*edges_hz, f) for f in frequency.grid if f != line_hz)])
    for first in range(0, lines.size, most):
        columns = line_columns(band, lines[first : first + most])
        pairs = np.stack(np.split(columns, 2, axis=1), axis=2).reshape(columns.shape)
        count = lines[first : first + most].size
        yield _band_scan(ScanPoints(effect.name, count, np.zeros(0), np.inf), pairs)


@dataclass(frozen=True, eq=False)
class BandOfDrive:
    """A band that is equal to every band of the same drive, so that campaigns with one drive share their scans."""

    band: Band
    digest: bytes

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BandOfDrive) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


@lru_cache(maxsize=16)
def _driven(band: Band) -> BandOfDrive:
    what = (band.sample_rate_hz, band.samples, band.antialias, band.first_order_hold, int(band.bins[0]), band.bins.size)
    return BandOfDrive(band, sha256(repr(what).encode() + band.drive_v.tobytes()).digest())


def scans_of(
    band: Band, edges_hz: tuple[float, float], line_hz: float | None, with_mismatch: bool
) -> Iterable[BandScan]:
    """All scans of a record, dense between ``edges_hz``; the lines of ``line_hz`` [Hz] are in the model.

    Those of a long record are made point by point while they are used: together they take 15 times the record.
    """
    if band.samples <= SHORT:
        return _kept_scans(_driven(band), edges_hz, line_hz, with_mismatch)
    return _scans(band, edges_hz, line_hz, with_mismatch, max(_AT_ONCE // (2 * band.bins.size), 1))


@lru_cache(maxsize=8)
def _kept_scans(
    driven: BandOfDrive, edges_hz: tuple[float, float], line_hz: float | None, with_mismatch: bool
) -> tuple[BandScan, ...]:
    scans = tuple(_scans(driven.band, edges_hz, line_hz, with_mismatch, sys.maxsize))
    if not scans:
        return ()
    whole = _together(scans)
    pairs = whole.columns.reshape(-1, 2, whole.columns.shape[1])
    return (replace(whole, blocks=blocked(pairs.swapaxes(0, 1).reshape(whole.columns.shape))),)


def _scans(
    band: Band, edges_hz: tuple[float, float], line_hz: float | None, with_mismatch: bool, most: int
) -> Iterator[BandScan]:
    """The scans in parts of at most ``most`` points."""
    for effect in scored_effects(with_mismatch):
        if effect.resonance is not None:
            yield from _mode_scans(effect, band, edges_hz, most)
        elif effect.mains_frequency:
            yield from _line_scans(effect, band, edges_hz, line_hz, most)


@dataclass(frozen=True, eq=False)
class ScannedProducts:
    """Products of whitened columns of one record, the g points of all scans one after the other.

    Parameters
    ----------
    scans : of which they are products.
    base : [J, r]' [J, r] (P + 1, P + 1).
    cross : [J, r]' Z (P + 1, S, g, 2), with the two columns of a point in each channel.
    squares : Z' Z (S, g, 3) of the columns of a point, 11, 12, 22; those of different channels are orthogonal.
    """

    scans: tuple[ScanPoints, ...]
    base: FloatArray
    cross: FloatArray
    squares: FloatArray

    def __add__(self, other: ScannedProducts) -> ScannedProducts:
        return ScannedProducts(
            self.scans, self.base + other.base, self.cross + other.cross, self.squares + other.squares
        )


def scanned_products(
    scans: Iterable[BandScan], rows: RealArray, weight: FloatArray, base: FloatArray
) -> ScannedProducts:
    """Products of the scans with the ``rows`` (P + 1, S, 2 W) [V] of the Jacobian and of the residual, hum lines taken out.

    Parameters
    ----------
    scans : of the record.
    rows : the rows.
    weight : (S, W), turns volts into sigmas.
    base : products (P + 1, P + 1) of the rows in sigmas.
    """
    power = weight**2
    level = power[:, :1]
    flat_weight = bool(np.all(power == level))
    weighted = rows if flat_weight else rows * np.tile(power, 2)
    flat = weighted.reshape(-1, rows.shape[2])
    single = cache(partial(_tiles, flat))
    found: list[ScanPoints] = []
    crosses, squares = [], []
    for scan in scans:
        cross = scan.products(flat, single).reshape(rows.shape[0], 2, -1, 2)
        crosses.append(cross * level[:, None] if flat_weight else cross.astype(np.float64))
        sums = level * scan.sums if flat_weight else scan.weighted_sums(np.tile(power, 2))
        squares.append(sums.reshape(2, -1, 3))
        found += scan.scans
    if not crosses:
        return ScannedProducts((), base, np.zeros((rows.shape[0], 2, 0, 2)), np.zeros((2, 0, 3)))
    if len(crosses) == 1:
        return ScannedProducts(tuple(found), base, crosses[0], squares[0])
    return ScannedProducts(_joined(found), base, np.concatenate(crosses, axis=2), np.concatenate(squares, axis=1))


def _tiles(rows: RealArray) -> NDArray[np.float32]:
    """Rows (n, 2 W) in single precision, and empty ones up to a whole tile: a product then takes a seventh less time."""
    out = np.zeros((-(-rows.shape[0] // _TILE) * _TILE, rows.shape[1]), dtype=np.float32)
    out[: rows.shape[0]] = rows
    return out
