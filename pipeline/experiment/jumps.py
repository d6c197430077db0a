"""Rows of a stepped sweep at a jump of the response, where the motion does not settle within a row.

    |dY/df| <= max |Y| / (zeta f0)           every row of a linear resonance, of diameter max |Y|

Near a fold of a nonlinear resonance the slowest decay rate goes to zero, and at the fold the motion leaves its branch: the row
in between belongs to neither.  A pass moves faster than the bound only there.  Source: Nayfeh and Mook, Nonlinear Oscillations
(1979), section 4.1 (jump); the bound is the speed of the circle Y = A i zeta f f0 / (f0^2 - f^2 + 2 i zeta f f0) at f0.

Shapes: N rows, n rows of a pass, S senses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray
from .tones import SweepPass, ToneRecord

#: Speed over the bound above which a step is a jump.  Linear passes reach 1.03 (seed 22 of the study of sweeps, 60 dB), jumps
#: begin at 1.17; without the rule 9 of 15 hardening and softening resonances with jumps end as "unknown".
_FASTER = 1.1
#: Standard deviations that noise adds to a step at most.
_SIGMAS = 6.0
#: Rows of a pass that jumps may take at most; above it the bound does not hold for this pass, and no row is left out.
_SHARE = 0.2


@dataclass(frozen=True)
class Jump:
    """Neighbouring rows of one pass at a jump: its record, the frequencies of the first and the last [Hz], and their number."""

    record: str
    first_hz: float
    last_hz: float
    rows: int


def jump_rows(record: ToneRecord, one: SweepPass, width_hz: float, sd_v: FloatArray) -> BoolArray:
    """(n,) whether a row of the pass ``one`` is beside a step that no linear response takes.

    Parameters
    ----------
    width_hz : zeta f0 of the narrowest resonance, half its width.
    sd_v : (N, S) sd of the real and of the imaginary part of each row [V].
    """
    kept = np.zeros(one.stop - one.first, dtype=bool)
    if record.kind != "sweep" or kept.size < 3:
        return kept
    y, f, sd = record.sense_v[one.rows], record.frequency_hz[one.rows], sd_v[one.rows]
    background = 0.5 * (y[0] + y[-1])
    largest = np.abs(y - background).max(axis=0)
    x = np.abs(np.diff(f))[:, None] / width_hz
    # Longest chord of the circle for a step x; its diameter is at most sqrt(1 + x^2 / 4) times the largest row.
    chord = largest * x / np.sqrt(1.0 + 0.25 * x**2)
    noise = _SIGMAS * np.sqrt(sd[1:] ** 2 + sd[:-1] ** 2)
    fast = np.any(np.abs(np.diff(y, axis=0)) > _FASTER * chord + noise, axis=1)
    kept[1:] |= fast
    kept[:-1] |= fast
    return kept if kept.mean() <= _SHARE else np.zeros_like(kept)


def jumps_of(record: ToneRecord, one: SweepPass, jumping: BoolArray) -> tuple[Jump, ...]:
    """The runs of ``jumping`` rows (n,) of a pass."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], jumping, [False]]).astype(np.int8)))
    f = record.frequency_hz[one.rows]
    return tuple(
        Jump(record.name, float(f[first]), float(f[stop - 1]), int(stop - first))
        for first, stop in zip(edges[::2], edges[1::2])
    )
