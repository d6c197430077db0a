"""Candidate terms of a campaign: the absent effects that change the records of any part, and those of its instruments."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ...criticism.problem import TermParameter
from ...criticism.regression import Term
from ...device.effect import Effect
from ...device.model import Model
from .part import Part


def terms_of(model: Model, parts: Sequence[Part], sized: Collection[str], even: frozenset[str]) -> tuple[Term, ...]:
    """The terms of ``parts`` whose parameters are ``sized``: some records change with them.  Those of ``even`` are squares."""
    refused = {name for part in parts for name in part.refused}
    names = dict.fromkeys(name for part in parts for name in part.effects if name not in refused)
    grids = [part.mode_grid() for part in parts]
    # Each point of the grid costs a slope: the widths are those of the part that resolves most of them.
    grid = tuple(sorted({f for own, _ in grids for f in own})), max((own for _, own in grids), key=len)
    levels = {name: values for part in parts for name, values in part.levels.items()}
    effects = [model.library[name] for name in names]
    found = [_level_term(effect, model, levels) or _term(effect, model, grid, sized, even) for effect in effects]
    own = [term for part in parts for term in part.own_terms]
    return (*(term for term in found if term is not None), *own)


def _level_term(effect: Effect, model: Model, levels: Mapping[str, tuple[float, ...]]) -> Term | None:
    """The term of an effect whose only parameter is a clip level: it has no slope at its null."""
    members = effect.members(model.built.shape)
    scanned = {effect.full_name(m): levels[effect.full_name(m)] for m in members if effect.full_name(m) in levels}
    if len(scanned) != len(members):
        return None
    return Term(
        effect.name, tuple(TermParameter(effect.full_name(m), m.unit, m.null, side=1) for m in members), scanned
    )


def _term(
    effect: Effect,
    model: Model,
    grid: tuple[tuple[float, ...], tuple[float, ...]],
    sized: Collection[str],
    even: frozenset[str],
) -> Term | None:
    members = effect.members(model.built.shape)
    plain = [m for m in members if not m.grid]
    if not plain or not all(effect.full_name(m) in sized for m in plain):
        return None
    scanned = {effect.full_name(m): m.grid for m in members if m.grid}
    if effect.mode is not None and not grid[0]:
        return None
    if effect.mode is not None:
        scanned |= dict(zip(effect.mode, grid))
    parameters = []
    for m in plain:
        side = 1 if m.low == m.null or effect.full_name(m) in even else -1 if m.high == m.null else 0
        parameters.append(TermParameter(effect.full_name(m), m.unit, m.null, np.inf, side))
    # Widths are tried at the resolution of the grid; a mode may be narrower.
    return Term(effect.name, tuple(parameters), scanned or None, frozenset((effect.mode or ())[1:]))
