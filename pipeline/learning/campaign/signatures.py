"""Signatures of absent effects in the rows of a campaign, and the candidates that they make.

Shapes: N samples, S senses, F bins, K columns; rows of a record 2 F S.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...criticism.problem import Candidate, TermParameter
from ...device.effect import Effect
from ...device.model import Model
from ...device.parameters import Parameter
from ...errors import ConfigError
from ...experiment.forward.response import response_sources
from ...experiment.forward.signatures import Base, Signature, base_of, signatures
from ...experiment.instrument import Instrument
from ...experiment.record import Record
from ...inference.general.fit import CampaignFit
from ...inference.general.residuals import Tasks

#: Clip levels that are scanned, as shares of the largest sample.
_LEVELS = (1.0, 0.997, 0.99, 0.97, 0.93, 0.85, 0.7)
#: A direction enters as (cos a, sin a), so two of them span all.
_AXES_DEG = (0.0, 90.0)


@dataclass(frozen=True, eq=False)
class Tangent:
    """A fitted model from which signatures are taken: the places of its records, play by play, and those records.

    ``rows`` takes volts (k, N, S) of the record at a place to its rows (k, 2 F S); ``peak_v`` is the largest sample.
    """

    model: Model
    groups: tuple[tuple[tuple[int, ...], Base], ...]
    rows: Callable[[int, FloatArray], FloatArray]
    peak_v: float


def tangent_of(
    fitted: CampaignFit,
    tasks: Tasks,
    instrument: Instrument,
    records: Sequence[Record],
    rows: Callable[[int, FloatArray], FloatArray],
) -> Tangent:
    """The tangent at a fit; ``tasks`` of its fit ``records`` at its values."""
    known = {r.name: r.start for r in fitted.records}
    starts = [known[record.name] for record in records]
    groups = tuple(
        (places, base_of(fitted.model, fitted.values, group, instrument, [starts[place] for place in places]))
        for places, group in tasks.groups
    )
    peak_v = max(float(np.max(np.abs(record.sense_v))) for record in records)
    return Tangent(fitted.model, groups, rows, peak_v)


def signature_of(at: Tangent, name: str) -> tuple[Candidate, list[list[FloatArray]]] | None:
    """The candidate and its columns (k, rows), part by part, of each record; ``None`` where the effect makes no sense."""
    effect = at.model.library[name]
    members = effect.members(at.model.built.shape)
    turned = next((m.name for m in members if m.per == "direction" or (m.name == "a" and m.grid)), None)
    grid: dict[str, tuple[float, ...]] = {}
    if turned is not None and len(members) > 1:
        grid[turned] = _AXES_DEG
    if effect.stages == ("adc",) and len(members) == 1:
        # A clip level above all samples changes nothing, and one far below them would be plain to see.
        grid[members[0].name] = tuple(1.0 / (at.peak_v * share) for share in _LEVELS)
    columns: list[list[FloatArray]] = [[] for _ in range(sum(len(places) for places, _ in at.groups))]
    found: list[Signature] = []
    hints: dict[str, float] = {}
    try:
        for number, (places, base) in enumerate(at.groups):
            for signature in signatures(base, name, grid=grid or None, step_hints=hints):
                hints = signature.steps
                if number == 0:
                    found.append(replace(signature, columns=np.zeros(0)))
                for k, (place, source) in enumerate(zip(places, response_sources(base.group, base.starts))):
                    own = at.rows(place, signature.columns[:, k]) if source == k else columns[places[source]][-1]
                    columns[place].append(own)
    except ConfigError:
        return None
    return _candidate(effect, members, found, turned), columns


def _candidate(
    effect: Effect, members: Sequence[Parameter], found: Sequence[Signature], turned: str | None
) -> Candidate:
    """The candidate whose columns are those of ``found``, one after the other; directions of one point share a cell."""
    own = [m for m in members if m.name in found[0].names]
    parameters = [
        TermParameter(
            effect.full_name(m),
            m.unit,
            m.null,
            max(abs(m.high - m.null), abs(m.low - m.null)),
            1 if m.low == m.null else (-1 if m.high == m.null else 0),
        )
        for m in own
    ]
    together = len(_AXES_DEG) if turned is not None and len(found) % len(_AXES_DEG) == 0 and len(found) > 1 else 1
    if together > 1:
        parameters = [replace(p, name=f"{p.name} at {a:g} deg") for a in _AXES_DEG for p in parameters]
    width = len(own) * together
    cells = tuple(slice(i * width, (i + 1) * width) for i in range(len(found) // together))
    grid = tuple({k: float(v) for k, v in s.point.items() if k != turned} for s in found[::together])
    return Candidate(effect.name, tuple(parameters), cells, grid)
