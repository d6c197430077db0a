"""The clock of a record: uniform time stamps, possibly rounded or jittered, with gaps at which the record is divided.

    t[n] = t[0] + n / f_s + e[n],    |e[n]| <= 1/2 sample, or one step of the resolution to which the stamps were rounded

Shapes: N samples.  Units: seconds, hertz.
"""

from __future__ import annotations

import itertools

import numpy as np

from ...arrays import FloatArray
from ...errors import MeasurementError
from ..record import Clock

#: Relative disagreement allowed between the time column and the declared sample rate.
RATE_TOLERANCE = 1e-4
#: Largest distance of a time stamp from the uniform grid, in samples: beyond it the order of the samples is not certain.
JITTER_TOLERANCE = 0.5
#: Most pieces of a record: a file with more gaps was not sampled uniformly.
MOST_PIECES = 64
#: Samples of the shortest record.
MIN_SAMPLES = 16
#: Samples on both sides of a long step over which the grid must move for it to be a gap and not jitter.
_AROUND = 16


def pieces(name: str, time_s: FloatArray, first_row: int = 0) -> list[slice]:
    """The uniform pieces of a record: ``time_s`` (N,) [s] is divided where samples are missing.

    ``first_row`` of the file is the first of ``time_s``; messages count the rows of the file.

    Raises
    ------
    MeasurementError : time runs backwards, a stamp occurs twice and the stamps are not rounded, or there are too many gaps.
    """
    steps = np.diff(time_s)
    typical = float(np.median(steps))
    if _is_rounded(time_s):
        return [slice(0, time_s.size)]
    if (backward := np.flatnonzero(steps <= 0.0)).size:
        row, last = int(backward[0]) + 1, int(backward[-1]) + 1
        at = first_row + row
        advice = [f"end the record before this row with stop = {at}"] if row >= MIN_SAMPLES else []
        advice += (
            [f"begin at row {first_row + last} with start = {first_row + last}"]
            if time_s.size - last >= MIN_SAMPLES
            else []
        )
        raise MeasurementError(
            f"{name}: {'a time stamp occurs twice' if steps[row - 1] == 0.0 else 'time runs backwards'}, first in row {at}",
            value=float(time_s[row]),
            allowed=f"steps of {typical:.6g} s everywhere (rows are counted from 0)",
            next_step=f"{' or '.join(advice)} in its [[record]], or measure again" if advice else "measure again",
        )
    gaps = [int(k) for k in np.flatnonzero(steps > 1.5 * typical) if _moves_grid(time_s, int(k), typical)]
    if len(gaps) >= MOST_PIECES:
        raise MeasurementError(
            f"{name}: {len(gaps)} gaps, the first before row {first_row + gaps[0] + 1}",
            value=float(time_s[gaps[0] + 1]),
            allowed=f"at most {MOST_PIECES - 1} gaps",
            next_step="resample the record to a uniform time, or measure again",
        )
    edges = [0, *(gap + 1 for gap in gaps), time_s.size]
    return [slice(first, stop) for first, stop in itertools.pairwise(edges)]


def clock_of(name: str, time_s: FloatArray, declared_hz: float | None, first_row: int = 0) -> Clock:
    """Sample rate and jitter of a uniform piece (N,) [s], which begins at ``first_row`` of the file.

    Raises
    ------
    MeasurementError : the stamps are not uniform, or their rate is not the declared one.
    """
    count = time_s.size
    rate, first = (count - 1) / float(time_s[-1] - time_s[0]), float(time_s[0])
    away = np.abs(time_s - first - np.arange(count) / rate) * rate
    rounded = bool(np.max(away) > 0.01) and _is_rounded(time_s)
    if np.max(away) > 0.01:
        # The ends are not exact either, so the grid is that of all stamps.
        step_s, away_s = _grid(time_s)
        rate, away = 1.0 / step_s, away_s / step_s
    row = int(np.argmax(away))
    if not (np.isfinite(rate) and (away[row] <= JITTER_TOLERANCE or rounded)):
        raise MeasurementError(
            f"{name}: time is not uniform, worst in row {first_row + row}",
            value=f"{away[row]:.3g} samples off the uniform grid",
            allowed=f"at most {JITTER_TOLERANCE} samples (rows are counted from 0)",
            next_step="resample the record to a uniform time; if the clock is uniform, remove time_s and state sample_rate_hz",
        )
    resolution = 3.0 * away[row] / count**1.5 if away[row] > 0.01 else 0.0
    if declared_hz is not None and abs(rate / declared_hz - 1.0) > RATE_TOLERANCE + resolution:
        raise MeasurementError(
            f"{name}: the sample rates of the time column and of [instrument] differ",
            value=f"{rate:.9g} Hz in time_s, {declared_hz:.9g} Hz declared",
            allowed=f"a relative difference of at most {RATE_TOLERANCE:g}",
            next_step=f"write sample_rate_hz = {rate:.9g} under [instrument], or remove time_s if it is wrong",
        )
    return Clock(float(f"{rate:.12g}"), float(away[row]), first)


def _is_rounded(time_s: FloatArray) -> bool:
    """Whether the stamps are a uniform clock, rounded or cut to multiples of a step above a twentieth of a sample."""
    count = time_s.size
    span = float(time_s[-1] - time_s[0])
    if not span > 0.0:
        return False
    step = span / (count - 1)
    moved = np.diff(time_s)
    positive = moved[moved > 0.0]
    unit = float(positive.min()) if positive.size else 0.0
    if np.any(moved < 0.0) or unit < 0.05 * step:
        return False
    multiples = (time_s - time_s[0]) / unit
    if np.max(np.abs(multiples - np.round(multiples))) > 1e-3 or (np.max(moved) < 1.01 * unit and np.min(moved) > 0.0):
        return False
    return bool(np.max(_grid(time_s)[1]) <= 0.55 * unit)


def _grid(time_s: FloatArray) -> tuple[float, FloatArray]:
    """Step [s] of the uniform grid nearest to all stamps (least squares), and the distance (N,) [s] of each from it."""
    n = np.arange(time_s.size) - (time_s.size - 1) / 2.0
    centred = time_s - time_s.mean()
    step_s = float(n @ centred) / float(n @ n)
    return step_s, np.abs(centred - n * step_s)


def _moves_grid(time_s: FloatArray, k: int, typical: float) -> bool:
    """Whether the grid of the stamps moves by at least a sample behind stamp ``k``, as jitter of one stamp does not."""
    n = np.arange(time_s.size)
    before, after = slice(max(k + 1 - _AROUND, 0), k + 1), slice(k + 1, k + 1 + _AROUND)
    phase = time_s - n * typical
    return bool(np.median(phase[after]) - np.median(phase[before]) > 0.75 * typical)
