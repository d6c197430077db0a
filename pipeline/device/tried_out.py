"""Refuses effects of users whose stages fail: each is called once, and a force is compiled, before a record is touched.

| stage | must give |
|---|---|
| drive, adc, sense | an array of the shape of the samples |
| mechanics, readout | Mechanics, Readout |
| disturbance | an array with one row per sample |
| force | nothing: it adds to ``out`` |

A stage that fails in its arithmetic alone (a square root of a negative number) is accepted: it may be right elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np

from ..user_code import fault, fault_at, line_of_compilation, line_of_result, reason
from .effect import Effect
from .example import Example, example_of, force_input, random
from .force_law import compiled_force
from .mechanics import Mechanics
from .readout import Readout, plain_readout

_GUIDE = "correct this line; docs/how-to/add-an-effect.md describes the stages"
_PLAIN = "plain arithmetic on numbers and elements of arrays, math, functions under @numba.njit"
_POINTS = 6


def with_working_stages(found: Mapping[str, Effect]) -> Mapping[str, Effect]:
    """``found``, unchanged.

    Raises
    ------
    ConfigError : a stage of an effect in a user's file fails or gives something else than it must, or its force does not compile;
        with file, line and statement.
    """
    for effect in found.values():
        # The effects of the library are tested.
        if effect.origin.endswith(".py"):
            try_out(effect)
    return found


@lru_cache(maxsize=256)
def try_out(effect: Effect) -> None:
    """Call every stage of ``effect`` once, at one scale of its parameters; raises as :func:`with_working_stages`."""
    example = example_of(effect)
    for stage in effect.stages:
        function, given, allowed = _call(effect, stage, example)
        what = f"the stage {stage!r} of the effect {effect.name!r} fails"
        try:
            with np.errstate(all="ignore"):
                found = function(*given)
        except (ArithmeticError, np.linalg.LinAlgError):
            continue
        except ValueError as error:
            if str(error) in ("math domain error", "math range error") or "expected a" in str(error):
                continue
            raise fault(what, error, effect.origin, _GUIDE) from error
        except Exception as error:
            raise fault(what, error, effect.origin, _GUIDE) from error
        if not allowed(found):
            line = line_of_result(function, effect.origin)
            raise fault_at(what, f"it gives {_described(found)}", effect.origin, line, _GUIDE, _MUST[stage])
    if effect.force is not None:
        _compile(effect)


_MUST = {
    "drive": "an array of the shape of the samples (N, drives)",
    "adc": "an array of the shape of the samples (N, senses)",
    "sense": "an array of the shape of the samples (N, senses)",
    "mechanics": "Mechanics with the shapes of the given one; coordinates may be appended",
    "readout": "Readout, as dataclasses.replace(readout, ..) gives",
    "disturbance": "an array (N, L) with one row per sample",
    "force": "nothing: it adds to out",
}


def _call(
    effect: Effect, stage: str, example: Example
) -> tuple[Callable[..., Any], tuple[Any, ...], Callable[[Any], bool]]:
    """The function of a stage, its arguments, and whether a result is what it must be."""
    p, context, shape = example.scale, example.context, example.shape
    t = np.linspace(0.0, 0.5, _POINTS)
    function = getattr(effect, stage)
    if stage in ("drive", "adc"):
        samples = random(_POINTS, shape.drives if stage == "drive" else shape.senses)
        return function, (samples, p, context), _array_of(samples.shape)
    if stage == "sense":
        x, s = 1e-4 * random(_POINTS, shape.senses), random(_POINTS, shape.senses)
        return function, (x, s.copy(), s.copy(), t, p, context), _array_of(s.shape)
    if stage == "mechanics":
        return function, (example.mechanics, p, context), lambda found: _continues(found, example.mechanics)
    if stage == "readout":
        poles = np.array([-3e4 + 1e4j, -3e4 - 1e4j])
        plain = plain_readout(poles, np.array([1e4 + 0j, 1e4 + 0j]), shape.senses, shape.drives)
        return function, (plain, p, context), lambda found: isinstance(found, Readout)
    if stage == "disturbance":
        return function, (t, p, context), lambda found: np.ndim(found) == 2 and np.shape(found)[0] == _POINTS
    given = force_input(effect, example)
    arguments = (0.5, given.q, given.qd, given.u, given.parameters(p), given.laws, np.zeros(given.q.size))
    return function, arguments, lambda found: found is None


def _array_of(shape: tuple[int, ...]) -> Callable[[Any], bool]:
    return lambda found: isinstance(found, np.ndarray) and found.shape == shape


def _continues(found: Any, before: Mechanics) -> bool:
    """Whether the arrays of ``found`` are those of ``before``, with coordinates appended at most."""
    if not isinstance(found, Mechanics):
        return False
    n = np.shape(found.stiffness)[-1] if np.ndim(found.stiffness) else 0
    grown = n - before.stiffness.shape[-1]
    for field in fields(Mechanics):
        old = getattr(before, field.name).shape
        square, sensed = old[1] == old[2] == before.stiffness.shape[-1], field.name.endswith("_sense")
        wanted = (old[0], n, n) if square else (old[0], old[1], n) if sensed else (old[0], n, old[2])
        if grown < 0 or np.shape(getattr(found, field.name)) != wanted:
            return False
    return True


def _described(found: Any) -> str:
    if isinstance(found, np.ndarray):
        return f"an array of shape {found.shape}"
    return "nothing" if found is None else f"a {type(found).__name__}"


def _compile(effect: Effect) -> None:
    """Compile the force; numba keeps the result beside the user's file."""
    assert effect.force is not None
    try:
        compiled_force(effect.force)
    except Exception as error:
        cause = error.__cause__ or error
        line = line_of_compilation(cause, effect.force, effect.origin)
        what = f"the force of the effect {effect.name!r} does not compile"
        raise fault_at(what, reason(cause), effect.origin, line, _GUIDE, _PLAIN) from error
