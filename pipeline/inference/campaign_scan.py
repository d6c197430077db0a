"""Where a fit starts for an effect whose parameters do not all exist at its null: a scan, without refits.

For each point of the grid the effect's columns c, with the columns J of the model without it projected out, would lower chi2 by

    g^T A^-1 g,      A = c^T (1 - J (J^T J)^-1 J^T) c,     g = c^T (1 - J (J^T J)^-1 J^T) r

A frequency is scanned at the strongest peaks of the residuals' spectrum instead of its grid.
Shapes: N samples, S senses, P parameters of the model without the effect, k columns of the effect; all in sigmas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.fft import rfft
from scipy.ndimage import uniform_filter1d

from ..arrays import FloatArray
from ..device.model import Model
from ..experiment.instrument import Instrument
from ..experiment.record import Record
from ..experiment.sensitivity import signatures

_PEAKS = 6


def peaks_hz(
    residuals: Sequence[FloatArray], sample_rate_hz: float, low_hz: float, high_hz: float
) -> tuple[float, ...]:
    """The strongest peaks [Hz] of the summed spectrum of residuals (N, S), sorted by height."""
    longest = max(r.shape[0] for r in residuals)
    frequency = np.arange(longest // 2 + 1) * sample_rate_hz / longest
    power = np.zeros(frequency.size)
    for r in residuals:
        own = np.sum(np.abs(rfft(r, axis=0)) ** 2, axis=1) / r.shape[0]
        power += np.interp(frequency, np.arange(own.size) * sample_rate_hz / r.shape[0], own)
    power = uniform_filter1d(power, 5)
    power[(frequency < low_hz) | (frequency > high_hz)] = 0.0
    found: list[float] = []
    for _ in range(_PEAKS):
        k = int(np.argmax(power))
        if power[k] == 0.0:
            break
        found.append(float(frequency[k]))
        power[max(0, k - 15) : k + 16] = 0.0
    return tuple(found)


def scan(
    model: Model,
    effect: str,
    values: Mapping[str, float],
    records: Sequence[Record],
    instrument: Instrument,
    angular_gain: float | None,
    residuals: Sequence[FloatArray],
    columns: Sequence[FloatArray],
    whiten: Sequence[Callable[[FloatArray], FloatArray]],
) -> dict[str, float]:
    """Start values of the parameters of ``effect``, by full name.

    Parameters
    ----------
    model : without the effect.
    effect : its name.
    values : complete parameters of ``model``.
    records, instrument, angular_gain : the fit records.
    residuals : (N, S) of each record in sigmas.
    columns : (N S, P) of each record in sigmas.
    whiten : takes volts (N, S, k) of each record to sigmas, nuisances projected out.
    """
    found = model.with_effect(effect).effect(effect)
    members = found.members(model.built.shape)
    grid = {}
    for member in members:
        if member.grid and member.unit == "Hz":
            top = min(member.high, records[0].sample_rate_hz / 2.0)
            grid[member.name] = peaks_hz(residuals, records[0].sample_rate_hz, member.low, top)
    normal = sum(j.T @ j for j in columns)
    scale = np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    slope = sum(j.T @ r.reshape(-1) for j, r in zip(columns, residuals))
    parts = []
    for record, r, j, white in zip(records, residuals, columns, whiten):
        own = []
        for s in signatures(model, values, record, instrument, effect, angular_gain=angular_gain, grid=grid):
            c = white(s.columns).reshape(r.size, -1)
            own.append((s, c.T @ c, c.T @ r.reshape(-1), c.T @ j))
        parts.append(own)
    best, start = -np.inf, {member.name: member.null for member in members}
    for same in zip(*parts):
        signature = same[0][0]
        gram, g, cross = (sum(part[i] for part in same) for i in (1, 2, 3))
        gram, g = gram - cross @ inverse @ cross.T, g - cross @ inverse @ slope
        acts_beyond = all(member.grid for member in members)
        size = np.ones(g.size) if acts_beyond else np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ g
        fall = float(2.0 * size @ g - size @ gram @ size)
        if fall > best:
            best = fall
            start = dict(signature.point) if acts_beyond else {**signature.point, **dict(zip(signature.names, size))}
    return {found.full_name(m): float(np.clip(start.get(m.name, m.null), m.low, m.high)) for m in members}
