"""Refuses effects of users whose null is not exactly "no effect".

At the null no stage of an effect is called, so a law that does not vanish there is another model next to its null than at it:
its size, its significance and its verdict would be wrong.  Each stage is called once at the null, on a device like the paper's.

A law that is not defined at its null (0/0) has a limit there, which is not known, and is accepted; so is one whose parameters all
have a grid, which is never used near its null.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import lru_cache

import numpy as np

from ..arrays import ComplexArray, FloatArray
from ..errors import ConfigError
from .effect import Context, Effect
from .example import Example, example_of, force_input, random
from .mechanics import Mechanics
from .readout import plain_readout

#: Change at the null, relative to what it changes or to the change at one scale of the parameters, that counts as rounding.
_ROUNDING = 1e-12
_POINTS = 6


def with_exact_nulls(found: Mapping[str, Effect]) -> Mapping[str, Effect]:
    """``found``, unchanged.

    Raises
    ------
    ConfigError : a stage of an effect in a user's file changes something at the null of its parameters.
    """
    for effect in found.values():
        # The effects of the library are tested.
        if effect.origin.endswith(".py") and (stage := changed_stage(effect)):
            values = ", ".join(f"{m.name} = {m.null:g}" for m in effect.parameters if not m.grid)
            raise ConfigError(
                f"the null of an effect is not exactly no effect: its stage {stage!r} changes something there",
                value=f"{effect.name} at {values} ({effect.origin})",
                allowed="a law that vanishes at the null values of its parameters",
                next_step="subtract what is left at the null, or declare null=.. where the law vanishes",
            )
    return found


@lru_cache(maxsize=256)
def changed_stage(effect: Effect) -> str:
    """Name of the first stage that is not exactly absent at the null; empty if all are."""
    example = example_of(effect)
    if all(member.grid for member in effect.members(example.shape)):
        return ""
    p, context, shape = example.null, example.context, example.shape
    changes: dict[str, Callable[[], float]] = {
        "drive": lambda: _of_samples(effect.drive, p, context, shape.drives),
        "mechanics": lambda: _of_mechanics(effect, p, context, example.mechanics),
        "force": lambda: _of_force(effect, example),
        "sense": lambda: _of_sense(effect, p, context, shape.senses),
        "readout": lambda: _of_readout(effect, p, context, shape.senses, shape.drives),
        "adc": lambda: _of_samples(effect.adc, p, context, shape.senses),
    }
    for stage in effect.stages:
        try:
            with np.errstate(all="ignore"):
                change = changes[stage]() if stage in changes else 0.0
        except Exception:
            # Not at the null; a stage that fails elsewhere has been refused before (``tried_out``).
            continue
        if change > _ROUNDING:
            return stage
    return ""


def _apart(after: FloatArray | ComplexArray, before: FloatArray | ComplexArray) -> float:
    """|after - before| / |before|; infinite where nothing was before."""
    change, size = float(np.linalg.norm(after - before)), float(np.linalg.norm(before))
    return change / size if size > 0.0 else (np.inf if change > 0.0 else 0.0)


def _of_samples(
    stage: Callable[[FloatArray, FloatArray, Context], FloatArray] | None, p: FloatArray, context: Context, width: int
) -> float:
    v = random(_POINTS, width)
    return 0.0 if stage is None else _apart(stage(v.copy(), p, context), v)


def _of_mechanics(effect: Effect, p: FloatArray, context: Context, before: Mechanics) -> float:
    """The change of the coordinates of the device; those that are appended must not carry the drive to the senses."""
    assert effect.mechanics is not None
    after, n = effect.mechanics(before, p, context), before.stiffness.shape[1]
    worst = 0.0
    for name in (field.name for field in fields(Mechanics)):
        old, new = getattr(before, name), getattr(after, name)
        worst = max(worst, _apart(new[tuple(slice(size) for size in old.shape)], old))
    square = (after.stiffness, after.damping, after.gyroscopic)
    through = np.linalg.norm(after.drive[:, n:]) * np.linalg.norm(after.velocity_sense[:, :, n:])
    return max(worst, float(through), *(float(np.linalg.norm(one[:, :n, n:])) for one in square))


def _of_force(effect: Effect, example: Example) -> float:
    """The force on the device's own coordinates at the null, relative to that at one scale of the parameters."""
    given = force_input(effect, example)

    def at(values: FloatArray) -> FloatArray:
        out = np.zeros(given.q.size)
        assert effect.force is not None
        effect.force(0.5, given.q, given.qd, given.u, given.parameters(values), given.laws, out)
        return out[: given.n]

    return float(np.linalg.norm(at(example.null)) / np.linalg.norm(at(example.scale)))


def _of_sense(effect: Effect, p: FloatArray, context: Context, senses: int) -> float:
    assert effect.sense is not None
    x, s = 1e-4 * random(_POINTS, senses), random(_POINTS, senses)
    return _apart(effect.sense(x, s.copy(), s.copy(), np.linspace(0.0, 0.5, _POINTS), p, context), s)


def _of_readout(effect: Effect, p: FloatArray, context: Context, senses: int, drives: int) -> float:
    assert effect.readout is not None
    before = plain_readout(np.array([-3e4 + 1e4j, -3e4 - 1e4j]), np.array([1e4 + 0j, 1e4 + 0j]), senses, drives)
    after, s = effect.readout(before, p, context), 2j * np.pi * np.array([10.0, 500.0, 3000.0])
    fed = float(np.abs(after.resistive).max() + np.abs(after.capacitive).max() + abs(after.delay_s))
    return max(fed, _apart(after.response(s), before.response(s)))
