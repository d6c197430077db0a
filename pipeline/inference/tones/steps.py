"""Differences by the parameters of a model, and their steps."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import inf
from typing import Any

from ...device.model import Model
from ...errors import ConfigError

#: Steps: of a frequency and a damping ratio in half-widths, of other parameters relative to themselves.
_STEP, _RELATIVE = 1e-3, 1e-5


def damping_names(model: Model) -> dict[str, str]:
    """Name of the frequency of each mode -> that of its damping ratio."""
    names = model.by_name
    plant = {n: f"zeta{n[1:-3]}" for n in names if n.endswith("_hz") and f"zeta{n[1:-3]}" in names}
    added = (effect.mode for effect in model.ordered_effects())
    return plant | {mode[0]: mode[1] for mode in added if mode is not None}


def difference_step(zetas: Mapping[str, str], name: str, values: Mapping[str, float], size: float) -> float:
    """Step at ``values``; ``zetas`` of ``damping_names``, ``size`` a typical value of the parameter."""
    at = abs(values.get(name, 0.0))
    if name in zetas:
        return _STEP * max(values.get(zetas[name], 1.0), 1e-9) * at
    if name in zetas.values():
        return _STEP * max(at, 1e-9)
    return max(_RELATIVE * at, 0.1 * size)


def slope(
    predict: Callable[[Mapping[str, float]], Sequence[Any]],
    values: Mapping[str, float],
    name: str,
    step: float,
    low: float,
) -> tuple[Any, ...]:
    """d Y / d parameter of every array of ``predict``, by a difference at ``values``.

    The difference is central, or one-sided where a step leaves the range of the parameter, which starts at ``low``, or has no
    solution: the motion grows, or has no steady state.

    Raises
    ------
    ConfigError : neither side has a solution.
    """

    def at(side: float) -> Sequence[Any]:
        return predict({**values, name: values[name] + side * step})

    if not values[name] - step < low <= values[name]:
        try:
            return tuple((a - b) / (2.0 * step) for a, b in zip(at(1.0), at(-1.0)))
        except ConfigError:
            pass
    here = at(0.0)
    try:
        return tuple((a - b) / step for a, b in zip(at(1.0), here))
    except ConfigError:
        return tuple((b - a) / step for a, b in zip(at(-1.0), here))


def lower_bound(model: Model, even: Collection[str], name: str) -> float:
    """Lower end of the range of a parameter; 0 for the squares ``even``, none for parameters that are not of the ``model``."""
    if name in even:
        return 0.0
    return model.by_name[name].low if name in model.by_name else -inf
