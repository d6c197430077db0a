"""Signatures of absent effects: how records move with their parameters, at the null.

One-sided differences where a deviation is integrated, which is free of cancellation; central ones where the change is a
difference of two records.

Shapes: R records, N samples, S senses, k parameters of an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from ..arrays import FloatArray
from ..device.effect import Effect
from ..device.model import Model
from ..device.parameters import Parameter
from ..errors import ConfigError
from .instrument import Instrument
from .play import Play, alone
from .response import Starts, converted, linear_volts, remainder_volts
from .sensitivity import SHARE, SLOPE_SUBSTEPS, STRONG
from .system import assemble


@dataclass(frozen=True, eq=False)
class Signature:
    """How records move with an absent effect.

    Parameters
    ----------
    effect : its name.
    names : of the parameters that the columns are derivatives to, k of them.
    point : values of its other parameters (those of a grid).
    columns : (k, R, N, S) dy/dp at the null; for a parameter that only acts beyond a threshold (a clip level) the
        change of y from no effect to ``point``.  Free regressors of a disturbance are ``basis`` (N, L) instead, k = 0.
    basis : (N, L), L = 0 but for disturbances.
    steps : of the differences, by parameter.
    """

    effect: str
    names: tuple[str, ...]
    point: dict[str, float]
    columns: FloatArray
    basis: FloatArray
    steps: dict[str, float]


def signatures(
    model: Model,
    parameters: Mapping[str, float],
    play: Play,
    instrument: Instrument,
    effect: str,
    *,
    starts: Starts | None = None,
    grid: Mapping[str, tuple[float, ...]] | None = None,
    step_hints: Mapping[str, float] | None = None,
    substeps: int = SLOPE_SUBSTEPS,
) -> Iterator[Signature]:
    """Signatures of the absent ``effect`` in the records of a play, at ``parameters`` of ``model``.

    One where all its parameters exist at the null; else one a point of the grid of those that do not (the product
    over them).

    Parameters
    ----------
    model, parameters, instrument : as in ``forward``.
    play, starts : the records, and the state of each at its first sample where it does not start at rest.
    effect : name of an effect that is not in the model.
    grid : parameter -> values to scan instead of the declared grid.
    step_hints : parameter -> a step to begin with, such as ``Signature.steps`` of a like play.
    substeps : of the integrator.

    Raises
    ------
    ConfigError : the effect is unknown, makes no sense for the plant, or is in the model already.
    """
    if effect in model.effects:
        raise ConfigError("effect is in the model already", value=effect, allowed=", ".join(model.candidates()))
    larger = model.with_effect(effect)
    found = larger.effect(effect)
    members = found.members(larger.built.shape)
    scanned = [m for m in members if m.grid]
    followed = [m for m in members if not m.grid]
    grids = [(grid or {}).get(m.name, m.grid) for m in scanned]
    values = model.complete(parameters)
    bends = found.force is not None or found.sense is not None
    moving = partial(_moving, model, larger, found, values, instrument)
    y0, moved = moving(play, starts, substeps)
    t = np.arange(y0.shape[1]) / play.sample_rate_hz

    steps = dict(step_hints or {})
    level = _rms(y0)
    unknown = [m for m in followed if bends and m.name not in steps]
    for at in product(*grids):
        point = {m.name: value for m, value in zip(scanned, at)}
        basis = np.zeros((y0.shape[1], 0))
        names: tuple[str, ...] = ()
        if found.disturbance is not None:
            context = assemble(model, values, instrument, play.conditions).context
            basis = found.disturbance(t, np.array([point.get(m.name, m.null) for m in members]), context)
            columns = np.zeros((0, *y0.shape))
        elif not followed:
            columns = moved(point, scanned[0].name, point[scanned[0].name])[None]
            names = tuple(m.name for m in scanned)
        else:
            if unknown:
                # One substep on the loudest record tells how far a step goes.
                loudest = max(range(len(play.drives)), key=lambda r: float(np.mean(play.drives[r] ** 2)))
                rough0, rough = moving(alone(play, loudest), None if starts is None else [starts[loudest]], 1)
                steps |= {m.name: _stepped(m, point, rough, _rms(rough0), 0.0, False)[0] for m in unknown}
                unknown = []
            slopes = [_derivative(m, point, moved, level, steps.get(m.name, 0.0), not bends) for m in followed]
            columns = np.stack([slope for slope, _ in slopes])
            names = tuple(m.name for m in followed)
            steps = {**steps, **{m.name: step for m, (_, step) in zip(followed, slopes)}}
        yield Signature(effect, names, point, columns, basis, dict(steps))


_Moved = Callable[[Mapping[str, float], str, float], FloatArray]


def _rms(y: FloatArray) -> float:
    return float(np.sqrt(np.mean(y**2)))


def _moving(
    model: Model,
    larger: Model,
    found: Effect,
    values: Mapping[str, float],
    instrument: Instrument,
    play: Play,
    starts: Starts | None,
    substeps: int,
) -> tuple[FloatArray, _Moved]:
    """Records (R, N, S) without the effect, and what moves in them: (point, parameter, value) -> (R, N, S)."""
    members = found.members(larger.built.shape)
    before = assemble(model, values, instrument, play.conditions)
    linear0 = linear_volts(before, play, starts)
    curved = bool(before.forces or before.senses)
    remainder0 = remainder_volts(before, play, starts, substeps) if curved else None
    y0 = linear0 if remainder0 is None else linear0 + remainder0
    bends = found.force is not None or found.sense is not None
    # A weak nonlinear effect changes what a linear one does in second order only.
    strong = remainder0 is not None and np.linalg.norm(remainder0) > STRONG * np.linalg.norm(linear0)

    def moved(point: Mapping[str, float], name: str, value: float) -> FloatArray:
        if found.adc is not None and found.stages == ("adc",):
            p = np.array([value if m.name == name else point.get(m.name, m.null) for m in members])
            return found.adc(y0, p, before.context) - y0
        trial = {**values, **{found.full_name(m): point[m.name] for m in members if m.grid}}
        trial[found.full_name(next(m for m in members if m.name == name))] = value
        system = assemble(larger, larger.complete(trial), instrument, play.conditions)
        if bends or strong:
            # Deviations free of cancellation: the linear part is the same unless the effect touches it.
            change = remainder_volts(system, play, starts, substeps)
            if remainder0 is not None:
                change -= remainder0
            if set(found.stages) & {"drive", "mechanics", "readout"}:
                change += linear_volts(system, play, starts)
                change -= linear0
        else:
            change = linear_volts(system, play, starts) - linear0
        if system.adcs:
            change = converted(system, y0 + change) - converted(before, y0)
        return change

    return y0, moved


def _derivative(
    member: Parameter,
    point: Mapping[str, float],
    moved: _Moved,
    level: float,
    hint: float,
    both_sides: bool,
) -> tuple[FloatArray, float]:
    """dy/dp (R, N, S) at the null and its step.

    One side is enough where deviations are integrated: what is curved is of the order of that share.  Where the change is
    a difference of two records, both sides are taken, so that the rounding common to them cancels.
    """
    step, first = _stepped(member, point, moved, level, hint, both_sides)
    if both_sides and member.null - step >= member.low:
        return (first - moved(point, member.name, member.null - step)) / (2.0 * step), step
    return first / step, step


def _stepped(
    member: Parameter, point: Mapping[str, float], moved: _Moved, level: float, hint: float, both_sides: bool
) -> tuple[float, FloatArray]:
    """A step that moves the records by about ``SHARE`` of their level, and that change (R, N, S).

    A record that jumps (a lag behind a feedthrough of held steps, without a filter) has no slope: ConfigError.
    """
    most = 0.25 * (member.high - member.null)
    step = min(hint or 1e-2 * member.scale, most)
    first = np.zeros(0)
    # Deviations are free of rounding, and two sides leave an error of second order only.
    shortest, longest = (1e-2, 1e3) if both_sides and member.null - step >= member.low else (1e-4, 1e2)
    for _ in range(12):
        try:
            first = moved(point, member.name, member.null + step)
            found = _rms(first) / max(level, 1e-300)
        except ConfigError:
            found = np.inf
        if found == 0.0 or shortest * SHARE <= found <= longest * SHARE:
            break
        step = min(step * (1e-3 if not np.isfinite(found) else float(np.clip(SHARE / found, 1e-6, 1e6))), most)
    else:
        if found > longest * SHARE:
            raise ConfigError("the record jumps at the null of a parameter", value=member.name)
    return step, first
