"""Start values of the modes of free decays: line by line from the largest pieces, each time all modes so far together.

    r_k = y - c - sum_(j<k) Re[a_j e^{p_j t}],     p_k starts at the strongest line of r_k;      then all p_1 .. p_k again

Among the poles that several pieces and the spectra propose, those count that leave the least energy over all fit records.

Shapes: N samples, S senses, K modes.  Poles in rad/s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...experiment.decays.backbone import line_hz, oscillations, strongest_channel
from ...experiment.record import Record

#: Pieces from which modes are proposed.
_PIECES = 3


def free_poles(records: Sequence[Record], modes: int, sigma_v: FloatArray, proposed: ComplexArray) -> ComplexArray:
    """Poles (K,) [rad/s] of the ``modes`` of records without a drive; ``proposed`` (K,) are those of another method."""
    largest = sorted(
        records, key=lambda record: -float(np.sum(np.var(record.sense_v, axis=0))) * record.sense_v.shape[0]
    )
    found = [proposed, *(_line_by_line(record, modes) for record in largest[:_PIECES])]
    best = min(found, key=lambda poles: energy_left(records, poles, sigma_v))
    return np.asarray(best[np.argsort(best.imag)])


def energy_left(records: Sequence[Record], poles: ComplexArray, sigma_v: FloatArray) -> float:
    """Energy [sigma^2] that decaying sines with these poles leave in the records, each with free amplitudes and offsets."""
    total = 0.0
    for record in records:
        rest = record.sense_v - _decaying(record, poles)
        total += float(np.sum((rest / sigma_v) ** 2))
    return total


def _decaying(record: Record, poles: ComplexArray) -> FloatArray:
    """The best offset and decaying sines (N, S) [V] with these poles (K,)."""
    t = np.arange(record.sense_v.shape[0]) / record.sample_rate_hz
    e = np.exp(np.minimum(np.outer(t, poles.real), 50.0) + 1j * np.outer(t, poles.imag))
    columns = np.concatenate([np.ones((t.size, 1)), e.real, e.imag], axis=1)
    columns = columns / np.linalg.norm(columns, axis=0)
    return np.asarray(columns @ np.linalg.lstsq(columns, record.sense_v, rcond=1e-12)[0])


def _line_by_line(record: Record, modes: int) -> ComplexArray:
    rate = record.sample_rate_hz
    poles = np.zeros(0, dtype=np.complex128)
    for _ in range(modes):
        rest = record.sense_v - (_decaying(record, poles) if poles.size else 0.0)
        start = [*(np.abs(poles) / (2.0 * np.pi)), line_hz(rest, rate) or 0.1 * rate]
        found = oscillations(strongest_channel(record.sense_v), rate, start)
        omega = 2.0 * np.pi * np.array([one.f_hz for one in found])
        zeta = np.clip(np.array([one.zeta for one in found]), 1e-6, 0.5)
        poles = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    return poles
