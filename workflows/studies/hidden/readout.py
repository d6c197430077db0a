"""Read-out paths that differ: delays, poles and clocks of single drives and channels, between the samples.

    y_s(n) = sum_d P_d P_s r_sd(t_n (1 - delta) - tau - tau_d - tau_s),     P: T p' = r - p

r_sd is the signal of channel s behind its filter that drive d causes.  It is known with r' and r'' at both ends of every
integration step, and between them it is the quintic through these six values.  A delay or a pole of one drive acts on what
this drive causes; that is exact for a linear device, so that drives are superposed for linear devices only.

No code is shared with the models of ``pipeline``.  Shapes: N samples, M integration steps, 2 channels.  Units: V, s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numba import njit

from pipeline.arrays import FloatArray

from .integrator import knots, lagged
from .physics import Physics

#: Library effects that are stated here for linear devices only.
PER_DRIVE = ("drive_delay", "drive_pole")
#: All that are stated here.
APART = (*PER_DRIVE, "channel_delay", "channel_pole", "clock_offset")


def is_apart(values: Mapping[str, float]) -> bool:
    """Whether paths or clocks differ at ``values``, so that :func:`read_out` is needed."""
    return any(name.partition(".")[0] in APART and value != 0.0 for name, value in values.items())


def read_out(values: Mapping[str, float], v: FloatArray, sample_s: float, steps: int, g: Physics) -> FloatArray:
    """The record (N, 2) [V] from rest for drive samples v (N, 2) [V]; ``steps`` integration steps per sample.

    What is read after the last sample belongs to a drive that is held.
    """
    channel_delay, channel_lag = _split(values, "channel_delay"), _single(values, "channel_pole", "channel")
    drive_delay, drive_lag = _split(values, "drive_delay"), _single(values, "drive_pole", "drive")
    slow = 1.0 - 1e-6 * float(values.get("clock_offset.delta", 0.0))
    due = np.asarray(np.arange(v.shape[0]) * (slow * sample_s) - g.delay_s, dtype=np.float64)
    last_s = due[-1] - min(channel_delay) - min(drive_delay)
    more = max(1, int(np.ceil(last_s / sample_s)) + 2 - v.shape[0])
    held = np.concatenate([v, np.repeat(v[-1:], more, axis=0)])
    parts = [(held, 0.0, 0.0)]
    if any((*drive_delay, *drive_lag)):
        parts = [(held * (np.arange(2) == d), drive_delay[d], drive_lag[d]) for d in range(2)]
    out = np.zeros((v.shape[0], 2))
    for driven, late_s, lag_s in parts:
        ends = knots(np.ascontiguousarray(driven), sample_s, steps, g)
        for s in range(2):
            lags = (g.pickoff_time_s, channel_lag[s], lag_s)
            out[:, s] += _read(ends[:, :, s], sample_s / steps, lags, due - (channel_delay[s] + late_s))
    return out


def _split(values: Mapping[str, float], effect: str) -> tuple[float, float]:
    """Delays [s] of the first and the second path."""
    tau = float(values.get(f"{effect}.tau", 0.0))
    return -0.5 * tau, 0.5 * tau


def _single(values: Mapping[str, float], effect: str, number: str) -> tuple[float, float]:
    """Time constants [s] of the first and the second path, of which one has a pole."""
    lag, own = float(values.get(f"{effect}.T", 0.0)), round(values.get(f"{effect}.{number}", 0.0))
    return (lag if own == 1 else 0.0), (lag if own == 2 else 0.0)


def _read(ends: FloatArray, step_s: float, lags: Sequence[float], when: FloatArray) -> FloatArray:
    """A signal (M, 2, 3) behind low-passes with time constants ``lags`` [s], at times ``when`` (N,) [s]; zero before 0."""
    ends = np.ascontiguousarray(ends)
    for lag in lags:
        if lag > 0.0:
            ends = _low_passed(ends, step_s, lag)
    place = when / step_s
    step = np.clip(np.floor(place).astype(np.int64), 0, ends.shape[0] - 1)
    share = place - step
    a, b = ends[step, 0], ends[step, 1]
    one, half = step_s, 0.5 * step_s**2
    c0, c1, c2 = a[:, 0], one * a[:, 1], half * a[:, 2]
    d0, d1, d2 = b[:, 0] - c0 - c1 - c2, one * b[:, 1] - c1 - 2.0 * c2, half * b[:, 2] - c2
    c3, c4, c5 = 10.0 * d0 - 4.0 * d1 + d2, -15.0 * d0 + 7.0 * d1 - 2.0 * d2, 6.0 * d0 - 3.0 * d1 + d2
    value = c0 + share * (c1 + share * (c2 + share * (c3 + share * (c4 + share * c5))))
    return np.where(place < 0.0, 0.0, value)


@njit(cache=True)
def _low_passed(ends: FloatArray, step_s: float, lag: float) -> FloatArray:
    """p, p', p'' at both ends of each step (M, 2, 3), of ``lag`` p' = y - p from rest; y is given in the same way."""
    out = np.empty_like(ends)
    p = 0.0
    for i in range(ends.shape[0]):
        for end in range(2):
            if end == 1:
                p = lagged(p, ends[i, 0], ends[i, 1], step_s, lag)
            out[i, end, 0] = p
            out[i, end, 1] = (ends[i, end, 0] - p) / lag
            out[i, end, 2] = (ends[i, end, 1] - out[i, end, 1]) / lag
    return out
