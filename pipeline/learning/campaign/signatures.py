"""Signatures of absent effects in the rows of a campaign, and the candidates that they make.

    Z = d model / d parameter / sigma      at the null of the effect, by differences of simulated records

Shapes: N samples, S senses, F bins, k columns of one effect, K of all; the rows of a record are 2 F S.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import Candidate, LocalCandidate, TermParameter, stratum_grams
from ...device.effect import Effect
from ...device.model import Model
from ...device.parameters import Parameter
from ...errors import ConfigError
from ...experiment.forward.clip_levels import clip_levels
from ...experiment.forward.response import response_sources
from ...experiment.forward.signatures import Base, Signature, base_of, signatures
from ...experiment.instrument import Instrument
from ...experiment.record import Record
from ...inference.general.fit import CampaignFit
from ...inference.general.free_disturbances import free_shapes
from ...inference.general.linear_step import relative_change
from ...inference.general.residuals import CampaignResiduals, Tasks
from .rows import FourierRows, white_rows

#: A direction enters as (cos a, sin a), so the signatures at two angles span those at all.
_AXES_DEG = (0.0, 90.0)


@dataclass(frozen=True, eq=False)
class Tangent:
    """A fitted model at which signatures are computed.

    Parameters
    ----------
    model : of the fit.
    groups : for each drive group the indices of its records and its simulated records.
    rows : takes an index of a record and volts (k, N, S) to rows (k, 2 F S).
    records : the measured records.
    norm_v : norm of the measured records [V].
    """

    model: Model
    groups: tuple[tuple[tuple[int, ...], Base], ...]
    rows: Callable[[int, FloatArray], FloatArray]
    records: tuple[Record, ...]
    norm_v: float


@dataclass(frozen=True, eq=False)
class KnownSignatures:
    """Signatures of some effects, and the predicted records at which they were computed.

    Parameters
    ----------
    candidates : those of the requested effects that make sense for the model.
    requested : names of the effects.
    blocks : for each fit record Z (2 F S, K).
    grams : Z' Z by noise stratum (strata, K, K).
    predicted_v : (N, S) of each fit record [V] by name.
    """

    candidates: tuple[Candidate, ...]
    requested: frozenset[str]
    blocks: tuple[FloatArray, ...]
    grams: FloatArray
    predicted_v: Mapping[str, FloatArray]

    def moved(self, fitted: CampaignFit) -> float:
        """rms(change) / rms(prediction) of the predicted fit records since the signatures were computed [1]."""
        now = fitted.of_role("fit")
        return relative_change(
            [self.predicted_v[record.name] for record in now], [record.predicted_v for record in now]
        )


def known_signatures(
    problem: CampaignResiduals,
    fitted: CampaignFit,
    names: Sequence[str],
    records: Sequence[Record],
    spectra: Sequence[FourierRows],
    strata: Sequence[IntArray],
    executor: Executor,
) -> KnownSignatures:
    """Signatures of the effects ``names`` at a fit; they are computed in parallel by ``executor``.

    ``records``, ``spectra`` and ``strata`` (2 F S,) are those of the fit records.
    """
    tasks = problem.tasks(records, fitted.values)

    def rows(index: int, y: FloatArray) -> FloatArray:
        return white_rows(problem, tasks.each[index], spectra[index], y)

    tangent = tangent_of(fitted, tasks, problem.instrument, records, rows)
    sizes = [2 * s.bins.size * record.sense_v.shape[1] for s, record in zip(spectra, records)]
    candidates, parts = _collected(executor.map(partial(signature_of, tangent), names), sizes)

    def stacked(place: int) -> tuple[FloatArray, FloatArray]:
        # Each column is contiguous in memory; the parts of a record are freed when they are copied.
        block = np.concatenate(parts[place]).T
        parts[place].clear()
        return block, stratum_grams((block,), (strata[place],))

    found = list(executor.map(stacked, range(len(parts))))
    grams = np.zeros((max(own.shape[0] for _, own in found), *found[0][1].shape[1:]))
    for _, own in found:
        grams[: own.shape[0]] += own
    predicted = {r.name: r.predicted_v for r in fitted.of_role("fit")}
    return KnownSignatures(candidates, frozenset(names), tuple(block for block, _ in found), grams, predicted)


def _collected(
    signatures: Iterable[tuple[Candidate, list[list[FloatArray]]] | None], sizes: Sequence[int]
) -> tuple[tuple[Candidate, ...], list[list[FloatArray]]]:
    """Candidates with their cells in common blocks, and for each record parts (k, rows) of its block of ``sizes`` rows."""
    candidates: list[Candidate] = []
    parts: list[list[FloatArray]] = [[np.empty((0, size))] for size in sizes]
    width = 0
    for found in signatures:
        if found is None:
            continue
        candidate, columns = found
        cells = tuple(slice(c.start + width, c.stop + width) for c in candidate.cells)
        candidates.append(replace(candidate, cells=cells))
        width += sum(part.shape[0] for part in columns[0])
        for known, own in zip(parts, columns):
            known.extend(own)
    return tuple(candidates), parts


def tangent_of(
    fitted: CampaignFit,
    tasks: Tasks,
    instrument: Instrument,
    records: Sequence[Record],
    rows: Callable[[int, FloatArray], FloatArray],
) -> Tangent:
    """The tangent at a fit: base of each drive group, for changes (k, N, S) [V] of its records.

    ``tasks`` belong to its fit ``records`` at its values; ``rows`` as in :class:`Tangent`.
    """
    known = {r.name: r.start for r in fitted.records}
    starts = [known[record.name] for record in records]
    groups = tuple(
        (places, base_of(fitted.model, fitted.values, group, instrument, [starts[place] for place in places]))
        for places, group in tasks.groups
    )
    norm_v = float(np.sqrt(sum(float(np.sum((r.sense_v - r.sense_v.mean(axis=0)) ** 2)) for r in records)))
    return Tangent(fitted.model, groups, rows, tuple(records), norm_v)


def signature_of(at: Tangent, name: str) -> tuple[Candidate, list[list[FloatArray]]] | None:
    """The candidate, and for each record its columns (k, 2 F S) by grid point; ``None`` if the effect does not apply."""
    effect = at.model.library[name]
    members = effect.members(at.model.built.shape)
    direction = effect.direction(at.model.built.shape)
    angle = None if direction is None else direction.name
    grid: dict[str, tuple[float, ...]] = {}
    if angle is not None and len(members) > 1:
        grid[angle] = _AXES_DEG
    grid |= clip_levels(effect, at.model.built.shape, at.records)
    columns: list[list[FloatArray]] = [[] for _ in range(sum(len(places) for places, _ in at.groups))]
    found: list[Signature] = []
    energy: list[FloatArray] = []
    hints: dict[str, float] = {}
    try:
        for number, (places, base) in enumerate(at.groups):
            for j, signature in enumerate(signatures(base, name, grid=grid or None, step_hints=hints)):
                hints = signature.steps
                if number == 0:
                    found.append(replace(signature, columns=np.zeros(0)))
                    energy.append(np.zeros(signature.columns.shape[0]))
                energy[j] += [float(np.vdot(column, column)) for column in signature.columns]
                for k, (place, source) in enumerate(zip(places, response_sources(base.group, base.starts))):
                    own = at.rows(place, signature.columns[:, k]) if source == k else columns[places[source]][-1]
                    columns[place].append(own)
    except ConfigError:
        return None
    size_v = np.sqrt(np.min(energy, axis=0))
    most = np.divide(at.norm_v, size_v, out=np.full(size_v.size, np.inf), where=size_v > 0.0)
    return _candidate(effect, members, found, angle, most), columns


def _candidate(
    effect: Effect, members: Sequence[Parameter], found: Sequence[Signature], angle: str | None, most: FloatArray
) -> Candidate:
    """The candidate whose columns are those of ``found`` in sequence; the directions of one grid point share a cell.

    ``most`` (k,): |value - null| at which each column is as large as the records; beyond it, it says nothing of its effect.
    """
    own = [m for m in members if m.name in found[0].names]
    parameters = [TermParameter.with_range(effect.full_name(m), m.unit, m.null, m.low, m.high) for m in own]
    parameters = [replace(p, reach=min(p.reach, float(limit))) for p, limit in zip(parameters, most)]
    together = len(_AXES_DEG) if angle is not None and len(found) % len(_AXES_DEG) == 0 and len(found) > 1 else 1
    if together > 1:
        parameters = [replace(p, name=f"{p.name} at {a:g} deg") for a in _AXES_DEG for p in parameters]
    width = len(own) * together
    cells = tuple(slice(i * width, (i + 1) * width) for i in range(len(found) // together))
    grid = tuple({k: float(v) for k, v in s.point.items() if k != angle} for s in found[::together])
    return Candidate(effect.name, tuple(parameters), cells, grid)


def disturbance_candidate(fitted: CampaignFit, records: Sequence[Record], name: str) -> LocalCandidate | None:
    """The disturbance ``name``, its amplitudes free in every fit record and channel: delta_chi2 by grid point.

    ``None`` where all of it lies above Nyquist.
    """
    residuals = {r.name: r.residual for r in fitted.records}
    shapes = free_shapes(
        fitted.model.library[name],
        fitted.model.built.shape,
        [residuals[record.name] for record in records],
        [record.sample_rate_hz for record in records],
    )
    shapes = tuple(shape for shape in shapes if shape.dof > 0)
    if not shapes:
        return None
    return LocalCandidate(
        name,
        tuple(shape.delta_chi2 for shape in shapes),
        tuple(shape.dof for shape in shapes),
        tuple({f"{name}.{k}": v for k, v in shape.point.items()} for shape in shapes),
        levels=tuple(shape.level for shape in shapes),
    )
