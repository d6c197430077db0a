"""Candidate terms of a modal record: the absent effects that change its poles or residues."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...arrays import RANK
from ...criticism.problem import TermParameter
from ...criticism.regression import Term
from ...device.effect import Effect
from ...device.model import Model
from ...errors import ConfigError
from ...inference.modal.model import ResonantModes, conditions, modelled_modes
from .rows import ModalRows


def declared_terms(model: Model, rows: ModalRows) -> tuple[str, ...]:
    """Absent effects that a declared condition of the record fixes."""
    known = conditions(rows.record).rate is not None
    return tuple(name for name in model.candidates() if known and model.library[name].condition == "rate")


def modal_terms(
    model: Model, rows: ModalRows, values: Mapping[str, float], at_null: ResonantModes, declared: Sequence[str]
) -> tuple[Term, ...]:
    """The absent effects that change poles or residues, as terms of a regression.

    Parameters
    ----------
    model, values : the model to start from, with start values of its parameters.
    rows : the record.
    at_null : modes of the model at ``values``: poles [rad/s] and residues (M, S, D) [1/s].
    declared : effects that are fixed by a declared condition.
    """
    names = (name for name in model.candidates() if name not in declared)
    found = (_term(model.library[name], model, rows, values, at_null) for name in names)
    return tuple(term for term in found if term is not None)


def _term(
    effect: Effect, model: Model, rows: ModalRows, values: Mapping[str, float], at_null: ResonantModes
) -> Term | None:
    if not {"mechanics", "readout"} & set(effect.stages):
        return None
    larger = model.with_effect(effect.name)
    members = effect.members(model.built.shape)
    plain = [m for m in members if not m.grid]
    scanned = {effect.full_name(m): m.grid for m in members if m.grid}
    sizes = {effect.full_name(m): m.null + m.scale for m in plain}
    try:
        trial = larger.complete({**values, **sizes, **{name: tried[0] for name, tried in scanned.items()}})
        (changed,) = modelled_modes(larger, [trial], rows.record, rows.measured.poles)
    except ConfigError:
        return None
    moved = (
        np.abs(changed.c - at_null.c).max() / rows.norms.max(),
        np.abs(changed.poles / at_null.poles - 1.0).max(),
    )
    if max(moved) < RANK:
        return None
    if np.any(changed.present != at_null.present):
        # The values tried are also the range of the fit.
        tried = {effect.full_name(m): (m.low, *m.grid, m.high) for m in members if m.grid}
        scanned = {name: _of_missing_mode(name, values, rows, at_null) for name, values in tried.items()}
    parameters = (TermParameter.with_range(effect.full_name(m), m.unit, m.null, m.low, m.high) for m in plain)
    return Term(effect.name, tuple(parameters), scanned or None)


def _of_missing_mode(name: str, tried: tuple[float, ...], rows: ModalRows, at_null: ResonantModes) -> tuple[float, ...]:
    """Values of a scanned parameter of an additional mode: those of the strongest mode that the model lacks, or ``tried``."""
    missing = np.flatnonzero(~at_null.present).tolist()
    mode = max(missing, key=lambda m: float(rows.norms[m] / -rows.measured.poles[m].real))
    held = {"f": rows.record.frequency_hz[mode], "zeta": rows.record.zeta[mode]}
    own = name.rpartition(".")[2]
    return (float(held[own]),) if own in held else tried
