"""The plane of time and frequency of each record, cut by what may have failed there; the same cut for every model tried.

Kinds: resonance (around the modes), harmonic (k times the instantaneous drive frequency, 1 being the drive itself; and k-fold
sums of the resonances, which ring on after the drive has passed), broadband (the rest, in bands between and beyond).

Shapes: N samples, S senses, D drives, K blocks, M bins.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise

import numpy as np

from ...arrays import FloatArray, IntArray
from ...experiment.noise.time_frequency import bin_frequencies, block_size, cell_variances, lapped
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit

Band = tuple[float, float]

HIGHEST = 5
LEVELS = 6
#: Half-width of a resonance and of a ridge, in bins.
_NEAR = 2.5
#: A drive has a frequency of its own in a block where this share of its energy lies within three bins of one.
_PURE = 0.9
#: The fine grid: widths below and beyond an edge, in units of the sample rate (25 and 250 Hz, 2.5 kHz at 10 kHz).
_FINE, _COARSE, _EDGE = 0.0025, 0.025, 0.25


@dataclass(frozen=True)
class Place:
    """A part of the plane: kind, band [Hz] that it lies in, order of the harmonic (0: none)."""

    kind: str
    band_hz: Band
    order: int = 0


@dataclass(frozen=True, eq=False)
class Plane:
    """How one record is cut.

    Parameters
    ----------
    sample_rate_hz : f_s [Hz].
    size : M.
    places, cell, place_dof : parts of the plane; part of each cell (K, M); degrees of freedom of each part.
    bands, band, band_dof : the fine grid of frequency; band of each bin (M,); degrees of freedom of each band.
    level, level_v : level of the motion of each short block (B, S); edges [V, rms] of the levels (LEVELS + 1, S).
    answers_hz : bands in which a narrow peak is an answer of the device, not a line.
    """

    sample_rate_hz: float
    size: int
    places: tuple[Place, ...]
    cell: IntArray
    place_dof: FloatArray
    bands: tuple[Band, ...]
    band: IntArray
    band_dof: FloatArray
    level: IntArray
    level_v: FloatArray
    answers_hz: tuple[Band, ...]


def planes_of(campaign: Campaign, fit: CampaignFit) -> dict[str, Plane]:
    """A plane a driven record, by name, with the resonances and responses of ``fit``."""
    records: Mapping[str, Record] = {record.name: record for record in campaign.records}
    rms = {mine.name: np.sqrt(np.mean(short_blocks(mine.predicted_v) ** 2, axis=1)) for mine in fit.records}
    top = np.maximum(np.max([level.max(axis=0) for level in rms.values()], axis=0), 1e-300)
    resonances = resonances_of(fit.values)
    return {name: _plane(records[name], level, top, resonances) for name, level in rms.items()}


def resonances_of(values: Mapping[str, float]) -> tuple[Band, ...]:
    """(f, zeta f) [Hz] of the modes, rising, from the values of a fitted model."""
    modes = [(values[n], values.get(f"zeta{n[1:-3]}", 0.0) * values[n]) for n in values if re.fullmatch(r"f\d*_hz", n)]
    return tuple(sorted((float(f), float(width)) for f, width in modes if f > 0.0))


def _plane(record: Record, rms_v: FloatArray, top_v: FloatArray, resonances: Sequence[Band]) -> Plane:
    samples, rate = record.drive_v.shape[0], record.sample_rate_hz
    size = block_size(samples)
    frequency, near = bin_frequencies(size, rate), 0.5 * _NEAR * rate / size
    variances = cell_variances(samples, size)
    inside = [(f, max(near, 20.0 * width)) for f, width in resonances if f < 0.5 * rate]
    groups = _groups(inside)
    drives, driven = _drive(record, size)
    edges = sorted(
        {0.0, *driven, *(e for group in groups for e in group), *_octaves(driven[1], 0.4 * rate), 0.5 * rate}
    )
    places = [Place("broadband", band) for band in pairwise(edges)]
    cell = np.tile(
        np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, len(places) - 1), (variances.size, 1)
    )
    for order in range(HIGHEST, 0, -1):
        mask = np.zeros(cell.shape, dtype=bool)
        for ridge in _ridges(drives, [f for f, _ in inside], order):
            mask |= np.abs(frequency - ridge[:, None]) <= near
        if mask.any():
            span = frequency[mask.any(axis=0)]
            cell[mask] = len(places)
            places.append(Place("harmonic", (float(span[0]), float(span[-1])), order))
    for low, high in groups:
        cell[:, (frequency >= low) & (frequency <= high)] = len(places)
        places.append(Place("resonance", (low, high)))
    weights = np.repeat(variances, size)
    bands, band = _grid(frequency, rate)
    steps = np.floor(LEVELS * (1.0 + np.log10(np.maximum(rms_v / top_v, 1e-3)) / 3.0))
    unswept = [] if np.isfinite(drives).any() else [driven]
    return Plane(
        rate,
        size,
        tuple(places),
        cell,
        np.asarray(np.bincount(cell.reshape(-1), weights, len(places)), dtype=np.float64),
        bands,
        band,
        np.asarray(np.bincount(band, minlength=len(bands)) * variances.sum(), dtype=np.float64),
        np.clip(steps, 0, LEVELS - 1).astype(np.int64),
        np.geomspace(1e-3 * top_v, top_v, LEVELS + 1),
        (*groups, *unswept, *_sums([f for f, _ in inside])),
    )


def _groups(resonances: Sequence[Band]) -> list[Band]:
    """Bands around (centre, half-width); those closer than their half-widths share one, neighbours meet half-way."""
    found: list[list[float]] = []
    for f, half in resonances:
        if found and f - found[-1][1] < half:
            found[-1][1:] = [f, max(found[-1][2], half)]
        else:
            found.append([f, f, half])
    bands = [[max(first - half, 0.0), last + half] for first, last, half in found]
    for left, right in pairwise(bands):
        if left[1] > right[0]:
            left[1] = right[0] = 0.5 * (left[1] + right[0])
    return [(float(low), float(high)) for low, high in bands]


def _octaves(high: float, below: float) -> list[float]:
    """2 high, 4 high, ... below a limit."""
    out, edge = [], 2.0 * high
    while 0.0 < edge < below:
        out.append(edge)
        edge *= 2.0
    return out


def _grid(frequency: FloatArray, rate: float) -> tuple[tuple[Band, ...], IntArray]:
    """Bands of the fine grid, none of them empty, and the band of each bin."""
    width = 2.0 * float(frequency[0])
    low = np.arange(0.0, _EDGE, max(_FINE, width / rate)) * rate
    high = np.arange(_EDGE, 0.5 - 0.5 * _COARSE, max(_COARSE, width / rate)) * rate
    edges = np.concatenate([low, high])
    band = np.searchsorted(edges, frequency, side="right") - 1
    kept, band = np.unique(band, return_inverse=True)
    ends = [float(edge) for edge in edges[kept]]
    return tuple(zip(ends, [*ends[1:], 0.5 * rate])), np.asarray(band, dtype=np.int64)


def _drive(record: Record, size: int) -> tuple[FloatArray, Band]:
    """(D, K) instantaneous frequency [Hz] of the drives, nan where a drive has none; band [Hz] of 99 % of their energy."""
    energy = lapped(record.drive_v, size) ** 2
    frequency = bin_frequencies(size, record.sample_rate_hz)
    share = np.cumsum(energy.sum(axis=(0, 1)))
    band = (0.0, 0.5 * record.sample_rate_hz)
    if share[-1] > 0.0:
        ends = np.searchsorted(share, np.array([0.005, 0.995]) * share[-1])
        half = float(frequency[0])
        band = (float(frequency[ends[0]]) - half, float(frequency[ends[1]]) + half)
    total = energy.sum(axis=2)
    around = np.abs(np.arange(size) - energy.argmax(axis=2)[..., None]) <= 3
    near = np.where(around, energy, 0.0).sum(axis=2)
    centre = np.where(around, energy * frequency, 0.0).sum(axis=2) / np.maximum(near, 1e-300)
    pure = (total > 1e-4 * max(float(total.max()), 1e-300)) & (near > _PURE * total)
    return np.asarray(np.where(pure, centre, np.nan)), band


def _ridges(drives: FloatArray, resonances: Sequence[float], order: int) -> list[FloatArray]:
    """(K,) sums of ``order`` drive frequencies; for orders above 1 also of as many resonances."""
    rows = [np.sum(some, axis=0) for some in combinations_with_replacement(list(drives), order)]
    if order == 1:
        return rows
    still = np.ones(drives.shape[1])
    return rows + [sum(some) * still for some in combinations_with_replacement(list(resonances), order)]


def short_blocks(y: FloatArray) -> FloatArray:
    """(N, S) -> (B, L, S): a few hundred short blocks of equal length; what is left at the end is in none."""
    length = max(y.shape[0] // 500, 4)
    count = y.shape[0] // length
    return y[: count * length].reshape(count, length, y.shape[1])


def _sums(resonances: Sequence[float]) -> list[Band]:
    """Bands about the sums of two to HIGHEST resonances, where they ring together."""
    sums = [sum(some) for k in range(2, HIGHEST + 1) for some in combinations_with_replacement(resonances, k)]
    return [(0.99 * f, 1.01 * f) for f in sums]
