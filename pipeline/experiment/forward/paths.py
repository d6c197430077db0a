"""Delays and poles of single channels and single drives, by superposition, and a clock that runs at another rate.

    y_s = sum_d y_sd,       y_sd: response of channel s to drive d alone, through the read-out of that path
    y[n] <- y(t_n - delta (t_0 + t_n))

Samples between samples are those of the polynomial through the nearest ``NODES``: 1e-8 of the signal at a twentieth of the sample
rate, 1e-5 at a fifth.

Shapes: R records, N samples, N' steps of the clock, D drives, S senses.  Units: volts, seconds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from ...arrays import FloatArray, IntArray
from ...device.readout import Readout
from .linear import shifted

#: Samples that a value between samples is computed from.
NODES = 20


def by_channel(readout: Readout, respond: Callable[[Readout], FloatArray]) -> FloatArray:
    """The response (.., S) whose channels are those of ``respond`` with the read-out of each channel."""
    if not np.any(readout.channel_delay_s):
        return respond(readout)
    parts = [respond(readout.path(s, None))[..., s] for s in range(readout.channel_delay_s.size)]
    return np.stack(parts, axis=-1)


def superposed(readout: Readout, respond: Callable[[Readout, int | None], FloatArray]) -> FloatArray:
    """The sum (.., S) over the drives of ``respond`` to each drive alone; one response where drives and channels are alike."""
    if not readout.differs:
        return respond(readout, None)
    apart = bool(np.any(readout.drive_delay_s) or np.any(readout.drive_time_s))
    drives: list[int | None] = list(range(readout.drive_delay_s.size)) if apart else [None]
    channels = range(readout.channel_delay_s.size)
    if not np.any(readout.channel_delay_s):
        return np.asarray(sum(respond(readout.path(0, drive), drive) for drive in drives))
    each = (np.stack([respond(readout.path(s, drive), drive)[..., s] for s in channels], axis=-1) for drive in drives)
    return np.asarray(sum(each))


def of_drive(gains: FloatArray, drive: int | None) -> FloatArray:
    """Gains (R, D, W) of which only one ``drive`` acts; all where it is ``None``."""
    if drive is None:
        return gains
    own = np.zeros_like(gains)
    own[:, drive] = gains[:, drive]
    return own


def lagged_drive(u: FloatArray, readout: Readout, step_s: float) -> FloatArray:
    """u (N', D) [V] behind the delays and poles of the drives: the mean over each step, for forces that depend on u."""
    if not (np.any(readout.drive_delay_s) or np.any(readout.drive_time_s)):
        return u
    # Loading scipy.signal takes a third of a second.
    from scipy.signal import lfilter

    out = np.empty_like(u)
    for d, (delay_s, time_s) in enumerate(zip(readout.drive_delay_s, readout.drive_time_s)):
        whole = int(np.floor(delay_s / step_s))
        share = delay_s / step_s - whole
        v = (1.0 - share) * shifted(u[:, d], whole) + share * shifted(u[:, d], whole + 1)
        if time_s > 0.0:
            kept = float(np.exp(-step_s / time_s))
            start = lfilter([0.0, 1.0 - kept], [1.0, -kept], v)
            v = v + (start - v) * (time_s / step_s) * (1.0 - kept)
        out[:, d] = v
    return out


def clocked(y: FloatArray, readout: Readout, elapsed_s: float, step_s: float) -> FloatArray:
    """y (.., N, S) [V] as the clock of the read-out samples it each ``step_s``, from ``elapsed_s`` after the start of the run."""
    samples = y.shape[-2]
    if readout.clock_offset == 0.0 or samples < NODES:
        return y
    n = np.arange(samples)
    place = n - readout.clock_offset * (n + elapsed_s / step_s)
    first = np.clip(np.floor(place).astype(np.int64) - NODES // 2 + 1, 0, samples - NODES)
    apart = (place - first)[:, None] - np.arange(NODES)
    # Barycentric weights of equal steps: (-1)^k binomial(NODES - 1, k).
    share = np.cumprod([1.0, *(-(NODES - k) / k for k in range(1, NODES))]) / np.where(apart == 0.0, 1.0, apart)
    share[np.any(apart == 0.0, axis=1)] = 0.0
    share[apart == 0.0] = 1.0
    share /= share.sum(axis=1, keepdims=True)
    out = np.empty(y.shape)
    _between(np.ascontiguousarray(y).reshape(-1, *y.shape[-2:]), first, share, out.reshape(-1, *y.shape[-2:]))
    return out


@njit(cache=True, nogil=True)
def _between(y: FloatArray, first: IntArray, share: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` (R, N, S) with sum_k share[n, k] y[r, first[n] + k]."""
    for r in range(y.shape[0]):
        for n in range(y.shape[1]):
            for s in range(y.shape[2]):
                total = 0.0
                for k in range(share.shape[1]):
                    total += share[n, k] * y[r, first[n] + k, s]
                out[r, n, s] = total
