"""Start values of an effect whose parameters do not all exist at its null, from a grid scan without refits.

At each grid point the columns c of the effect would lower chi2 by

    delta_chi2 = g^T A^-1 g,      A = c^T (1 - J (J^T J)^-1 J^T) c,     g = c^T (1 - J (J^T J)^-1 J^T) r

with the columns J of the model without the effect projected out.  A frequency is scanned at its likely values, or else at the
strongest peaks of the spectrum of the residuals, not on its grid.

Shapes: N samples, S senses, P parameters of the model without the effect, k columns of the effect; all in sigmas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import rfft
from scipy.ndimage import uniform_filter1d

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.forward.clip_levels import clip_levels
from ...experiment.forward.signatures import Signature, base_of, signatures
from ...experiment.instrument import Instrument
from .gauss_newton import PATIENCE
from .residuals import Tasks


def peaks_hz(
    residuals: Sequence[FloatArray], sample_rate_hz: float, low_hz: float, high_hz: float
) -> tuple[float, ...]:
    """Frequencies [Hz] of the strongest peaks between ``low_hz`` and ``high_hz`` of the summed spectrum, highest first.

    residuals : (N, S) of each record, sampled at ``sample_rate_hz``.
    """
    longest = max(r.shape[0] for r in residuals)
    frequency = np.arange(longest // 2 + 1) * sample_rate_hz / longest
    power = np.zeros(frequency.size)
    for r in residuals:
        own = np.sum(np.abs(rfft(r, axis=0)) ** 2, axis=1) / r.shape[0]
        power += np.interp(frequency, np.arange(own.size) * sample_rate_hz / r.shape[0], own)
    power = uniform_filter1d(power, 5)
    power[(frequency < low_hz) | (frequency > high_hz)] = 0.0
    found: list[float] = []
    for _ in range(PATIENCE):
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
    tasks: Tasks,
    instrument: Instrument,
    starts: Sequence[FloatArray | None],
    residuals: Sequence[FloatArray],
    columns: Sequence[FloatArray],
    whiten: Sequence[Callable[[FloatArray], FloatArray]],
    likely: Mapping[str, tuple[float, ...]],
) -> dict[str, float]:
    """Start values of the parameters of ``effect`` by full name, inside their ranges.

    Parameters
    ----------
    model : without the effect.
    effect : its name.
    values : complete parameters of ``model``.
    tasks, instrument : the fit records.
    starts : initial state (2n,) of each record; ``None`` is rest.
    residuals : (N, S) of each record in sigmas.
    columns : (N S, P) of each record in sigmas, those of all initial states included.
    whiten : for each record a function from volts (k, N, S) to sigmas, nuisances projected out.
    likely : frequencies [Hz] by parameter name that are scanned instead of the peaks.
    """
    found = model.with_effect(effect).effect(effect)
    members = found.members(model.built.shape)
    grid = {}
    rate = tasks.each[0].record.sample_rate_hz
    for member in members:
        if member.grid and member.unit == "Hz":
            top = min(member.high, rate / 2.0)
            grid[member.name] = likely.get(member.name) or peaks_hz(residuals, rate, member.low, top)
    if found.clips("drive"):
        # Its declared grid holds all drives that may occur; each point of it takes a response.
        grid |= clip_levels(found, model.built.shape, [task.record for task in tasks.each])
    normal = sum(j.T @ j for j in columns)
    scale = np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
    slope = sum(j.T @ r.reshape(-1) for j, r in zip(columns, residuals))
    sums: dict[int, list[FloatArray]] = {}
    at: list[Signature] = []
    for places, group in tasks.groups:
        base = base_of(model, values, group, instrument, [starts[place] for place in places])
        for k, signature in enumerate(signatures(base, effect, grid=grid)):
            if k == len(at):
                at.append(replace(signature, columns=np.zeros(0)))
            for own, place in enumerate(places):
                r, j = residuals[place].reshape(-1), columns[place]
                c = whiten[place](signature.columns[:, own]).reshape(-1, r.size)
                products = [c @ c.T, c @ r, c @ j]
                sums[k] = [a + b for a, b in zip(sums[k], products)] if k in sums else products
    ranges = {member.name: member for member in members}
    best, start = -np.inf, {member.name: member.null for member in members}
    for k, signature in enumerate(at):
        gram, g, cross = sums[k]
        gram, g = gram - cross @ inverse @ cross.T, g - cross @ inverse @ slope
        all_scanned = all(member.grid for member in members)
        size = np.ones(g.size) if all_scanned else np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ g
        if not all_scanned:
            # A size beyond a range would start at its limit, which may be the null, from where the scanned ones do not show.
            limits = [(ranges[name].low, ranges[name].high) for name in signature.names]
            size = np.clip(size, *np.array(limits).T)
        delta_chi2 = float(2.0 * size @ g - size @ gram @ size)
        if delta_chi2 > best:
            best = delta_chi2
            start = dict(signature.point) if all_scanned else {**signature.point, **dict(zip(signature.names, size))}
    return {found.full_name(m): float(np.clip(start.get(m.name, m.null), m.low, m.high)) for m in members}
