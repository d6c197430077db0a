"""Outliers of one sense channel: spikes and stuck samples.

A sample is a spike if its size |s| (see ``arx``) exceeds the local scale of s by more than noise does with probability ``ALPHA``
per record; the tail of the noise is a Student distribution with the measured 50 and 99 % quantiles.  Found samples are
interpolated, so that sum e^2 is least, before the next are sought (Godsill and Rayner, Digital Audio Restoration, 1998,
chapter 5).  A run of equal values is stuck if a sample in it or next to it is such an outlier, so silence after quantisation, and
motion that decays below one LSB, are not stuck.

A long record is searched in parts of half a million samples at most, which bounds the memory; they overlap, so that a sample
near the end of a part has its neighbours.

Shapes: N samples, D drives, R runs, K bad samples.  Volts.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.special import bdtrc, ndtri, stdtrit

from ..arrays import BoolArray, FloatArray, IntArray
from .arx import ORDER, Arx

#: Largest share of bad samples in a channel of a record that is used.
MOST_BAD = 0.02
#: Probability of a false alarm in one channel of one record.
ALPHA = 1e-4
#: First samples of a record in which no spike is sought.
_TRANSIENT = 12
#: Samples that share one local scale: a tenth of the time in which a sweep crosses a resonance.
_BLOCK = 256
#: Shortest run of equal values that can be stuck.
_SHORTEST = 3
#: Noise below this share of the rms is not resolved: where the drive starts, the prediction of a record without noise is wrong
#: by 1.4e-4 of the rms, which would be a spike with less than half of this value.
_UNRESOLVED = 5e-5
#: Distance from the extreme of a record, in local sds, within which clipped samples with noise lie.
_AT_LEVEL = 8.0
#: Probability of outliers as near to the extremes by chance below which the record counts as clipped.
_CLIPS = 1e-3
#: Samples on either side of a run of equal values that show how often successive samples are equal.
_BESIDE, _NEXT = 64, 6
#: Share of the samples that must lie far from all spikes to measure the tail of the noise; with 3 % spikes a fifth of them does.
_FAR = 0.05
_FITS, _ROUNDS = 4, 60
#: Samples of a part, at least, and of its overlap with the next.
_PART, _OVERLAP = 2**18, 1024


def parts(samples: int) -> list[tuple[slice, slice]]:
    """Parts of a record of N ``samples``, each without and with its overlap; one for a short record."""
    edges = np.linspace(0, samples, max(1, samples // _PART) + 1).astype(int).tolist()
    return [(slice(a, b), slice(max(a - _OVERLAP, 0), min(b + _OVERLAP, samples))) for a, b in pairwise(edges)]


def outliers(y: FloatArray, drive_v: FloatArray, known: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Outliers (N,) of y (N,) other than ``known`` ones (N,), and those of them that are stuck; drive (N, D) [V]."""
    found, stuck = np.zeros(y.size, dtype=bool), np.zeros(y.size, dtype=bool)
    spans = parts(y.size)
    for own, wide in spans:
        there = _outliers(y[wide], drive_v[wide], known[wide], y.size)
        inside = slice(own.start - wide.start, own.stop - wide.start)
        found[own], stuck[own] = there[0][inside], there[1][inside]
    if len(spans) > 1 and stuck.any():
        # A stuck run ends where the values change, in whatever part that is.
        for first, stop in stretches(np.concatenate([[False], np.diff(y) == 0.0]) | stuck):
            if np.any(stuck[first:stop]):
                found[first:stop] = stuck[first:stop] = ~known[first:stop]
    return found, stuck


def _outliers(y: FloatArray, drive_v: FloatArray, known: BoolArray, samples: int) -> tuple[BoolArray, BoolArray]:
    """The same for a part of a record of ``samples``."""
    none = np.zeros(y.size, dtype=bool)
    if y.size < 8 * ORDER or np.ptp(y[~known]) == 0.0:
        return none, none
    runs = _runs(y)
    floor = max(0.5 * _step(y), _UNRESOLVED * float(np.std(y[~known])))
    found, stuck = none, none
    for _ in range(_FITS):
        before = found
        arx = Arx.fitted(y, drive_v, known | found)
        found, stuck = _sought(arx, y, known, runs, floor, samples)
        if np.array_equal(found, before) or np.count_nonzero(found) > 5.0 * MOST_BAD * y.size:
            break
    return found, stuck


def _sought(
    arx: Arx, y: FloatArray, known: BoolArray, runs: IntArray, floor: float, samples: int
) -> tuple[BoolArray, BoolArray]:
    """Outliers (N,) under one ARX model, and those that are stuck; ``runs`` (R, 2) of equal values, ``floor`` [V]."""
    stuck = _constant(y, runs, samples)
    found = known | stuck
    mended = arx.interpolated(y, np.flatnonzero(found))
    run_of = np.full(y.size, -1)
    for number, (first, stop) in enumerate(runs):
        run_of[max(first - 1, 0) : stop + 1] = number
    for _ in range(_ROUNDS):
        size = arx.sizes(mended) * arx.weights
        scale = _local_scale(size, found, floor)
        unit = np.abs(size) / scale
        unit[found] = 0.0
        outlier = unit > _threshold(unit[~found], samples)
        # The first samples of a record that starts in motion hold the transient of the anti-alias filter.
        outlier[:_TRANSIENT] = False
        inwards = size * (y - np.median(y)) < 0.0
        # Motion beyond an extreme of the record was expected here, so the sample was clipped.
        clipped = inwards & _at_level(y, ~found & (~outlier | inwards), scale)
        places = np.flatnonzero(outlier & (unit >= maximum_filter1d(unit, 2 * ORDER + 1)) & ~clipped)
        if not places.size:
            break
        for n in places.tolist():
            found[n] = True
            if run_of[n] >= 0:
                first, stop = runs[run_of[n]]
                found[first:stop] = stuck[first:stop] = True
        mended = arx.interpolated(y, np.flatnonzero(found))
    found = _without_clipping(y, found, _local_scale(arx.sizes(mended) * arx.weights, found, floor))
    return found & ~known, stuck & found


def _at_level(y: FloatArray, motion: BoolArray, scale: FloatArray) -> BoolArray:
    """Whether a sample of y (N,) lies at an extreme of the ``motion``, within the noise: clipped samples do."""
    centre = float(np.median(y))
    out = np.zeros(y.size, dtype=bool)
    for sign in (-1.0, 1.0):
        away = sign * (y - centre)
        if np.any(own := motion & (away > 0.0)):
            level = float(np.max(away[own]))
            out |= (away > level - _AT_LEVEL * scale) & (away < level + _AT_LEVEL * scale)
    return out


def _without_clipping(y: FloatArray, found: BoolArray, scale: FloatArray) -> BoolArray:
    """The outliers ``found`` (N,) without those that clipping causes.

    Bad samples occur anywhere, so the share of their groups that lies near the extremes of the record is that of all samples.
    Where it is larger, the record is clipped, and outliers near the extremes belong to the motion.
    """
    groups = stretches(maximum_filter1d(found, 2 * ORDER + 1))
    near = maximum_filter1d(_at_level(y, ~found, scale), 2 * ORDER + 1)
    alike = sum(bool(np.any(near[a:b] & found[a:b])) for a, b in groups)
    if not alike or bdtrc(alike - 1, len(groups), float(np.mean(near))) > _CLIPS:
        return found
    return np.asarray(found & ~near)


def _local_scale(size: FloatArray, bad: BoolArray, floor: float) -> FloatArray:
    """Robust sd (N,) [V] of the sizes s (N,) around each sample, not below ``floor``."""
    blocks = max(size.size // _BLOCK, 1)
    edges = np.linspace(0, size.size, blocks + 1).astype(int)
    # One row for each block, sorted with what is missing at its end: the median is the mean of the middle two.
    lengths = np.diff(edges)
    rows = np.full((blocks, lengths.max()), np.nan)
    rows[np.arange(lengths.max()) < lengths[:, None]] = np.where(bad, np.nan, np.abs(size))
    rows.sort(axis=1)
    own, first = np.count_nonzero(~np.isnan(rows), axis=1), np.arange(blocks)
    level = 0.5 * (rows[first, (own - 1) // 2] + rows[first, own // 2])
    known = np.flatnonzero(np.isfinite(level))
    if not known.size:
        return np.full(size.size, np.inf)
    centres = 0.5 * (edges[:-1] + edges[1:])
    scale = 1.4826 * np.interp(np.arange(size.size), centres[known], level[known])
    return np.asarray(np.sqrt(scale**2 + floor**2))


@lru_cache(maxsize=1)
def _student_tails() -> tuple[FloatArray, FloatArray]:
    """1/nu from 0.001 to 0.5, and the ratio of the 99 to the 50 % quantile of |t_nu|."""
    inverse = np.linspace(1e-3, 0.5, 200)
    return inverse, np.asarray(stdtrit(1.0 / inverse, 0.995) / stdtrit(1.0 / inverse, 0.75))


def _threshold(unit: FloatArray, samples: int) -> float:
    """Level that noise like ``unit`` (N,), in local sds, exceeds in a record of ``samples`` with probability ``ALPHA``."""
    quantile = 1.0 - 0.5 * ALPHA / samples
    # A spike raises s around it too, so it must not count for the tail of the noise.
    far = maximum_filter1d(unit, 2 * ORDER + 1) < ndtri(quantile)
    if np.count_nonzero(far) < _FAR * unit.size:
        return float(ndtri(quantile))
    half, high = np.quantile(unit[far], [0.5, 0.99])
    # Quantised noise has a scale that is bounded by the LSB rather than measured.
    if half < 0.3:
        return float(ndtri(quantile))
    inverse, ratios = _student_tails()
    nu = 1.0 / float(np.interp(high / half, ratios, inverse))
    return float(stdtrit(nu, quantile)) * float(half) / float(stdtrit(nu, 0.75))


def _runs(y: FloatArray) -> IntArray:
    """(R, 2) first sample and the one after the last of each run of at least ``_SHORTEST`` equal values."""
    found = [(a, b + 1) for a, b in stretches(np.diff(y) == 0.0) if b + 1 - a >= _SHORTEST]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _constant(y: FloatArray, runs: IntArray, samples: int) -> BoolArray:
    """Samples (N,) in runs of equal values that are too long for noise of several LSB, as a silent record has.

    With a probability q that two successive samples are equal, a run of L occurs N q^(L-1) times.  q is taken from both sides
    of the run, where the samples must change by two steps: a mode that decays below one step does not.
    """
    out, step = np.zeros(y.size, dtype=bool), _step(y)
    for first, stop in runs[runs[:, 1] - runs[:, 0] > _SHORTEST]:
        before, after = np.diff(y[max(first - _BESIDE, 0) : first]), np.diff(y[stop : stop + _BESIDE])
        sides = [side for side in (before[::-1], after) if side.size >= _BESIDE // 2]
        # Next to the top of a slow wave the samples change by one step.
        if not sides or min(float(np.mean(side[:_NEXT] ** 2)) for side in sides) < 4.0 * step**2:
            continue
        equal = max((np.count_nonzero(side == 0.0) + 1.0) / (side.size + 2.0) for side in sides)
        out[first:stop] |= bool(samples * equal ** (stop - first - 1) < ALPHA)
    return out


def stretches(mask: BoolArray) -> list[tuple[int, int]]:
    """First sample, and the one after the last, of each run of true samples in ``mask`` (N,)."""
    edges = (np.flatnonzero(mask[1:] != mask[:-1]) + 1).tolist()
    edges = [0] * bool(mask[:1].any()) + edges + [mask.size] * bool(mask[-1:].any())
    return list(zip(edges[::2], edges[1::2]))


def _step(y: FloatArray) -> float:
    """Smallest difference [V] between values of y (N,), 0 where nearly every sample has a value of its own."""
    values = np.unique(y)
    return float(np.min(np.diff(values))) if 1 < values.size < 0.5 * y.size else 0.0
