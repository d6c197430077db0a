"""Derivatives of the record: to the parameters of a model, and to those of an effect that is not in it.

Central differences in the model's smooth coordinates through the exact bank, one-sided of second order where a range
ends; one-sided ones through the integrator for forces and pick-off laws, whose deviation is free of cancellation.
With strong nonlinear effects ``exact`` adds the remainder's share to the columns of the plant and of linear effects
too.

Shapes: R records, N samples, S senses, P free parameters, k parameters of an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from ..arrays import FloatArray
from ..device.effect import Effect
from ..device.model import Model
from ..device.parameters import Parameter
from ..errors import ConfigError, MeasurementError
from ..threads import mapped
from .instrument import Instrument
from .play import Play, alone, play_of
from .record import Record
from .response import Starts, converted, linear_volts, remainder_volts, volts
from .system import System, assemble

#: A step of an effect's parameter moves the record by about this share.
_SHARE = 1e-6
#: Share of the record made by forces and pick-off laws from which linear parts are followed through them too.
STRONG = 0.1
#: Substeps of the integrator where only slopes are wanted: they need not be as exact as a record.
SLOPE_SUBSTEPS = 2
_GRIDDED_STAGES = {"force", "sense"}


def channels_checked(model: Model, record: Record) -> None:
    """Refuse a record whose numbers of channels are not the plant's.

    Raises
    ------
    MeasurementError : they differ.
    """
    shape = model.built.shape
    found = [record.drive_v.shape[1], record.sense_v.shape[1]]
    if found != [shape.drives, shape.senses]:
        raise MeasurementError(
            f"record {record.name!r} has another number of drives and senses than the plant",
            value=found,
            allowed=str([shape.drives, shape.senses]),
            next_step='use plant = { kind = "modal", .. }',
        )


def _slope(f: Callable[[float], FloatArray], at: float, step: float, low: float, high: float) -> FloatArray:
    """df/dx at ``at`` to second order, inside [low, high]."""
    if at - step >= low and at + step <= high:
        return (f(at + step) - f(at - step)) / (2.0 * step)
    if at - step < low:
        return (4.0 * f(at + step) - f(at + 2.0 * step) - 3.0 * f(at)) / (2.0 * step)
    return (3.0 * f(at) - 4.0 * f(at - step) + f(at - 2.0 * step)) / (2.0 * step)


def is_gridded(model: Model, name: str) -> bool:
    """Whether a parameter is that of a force or a pick-off law."""
    effect = name.partition(".")[0]
    return effect in model.effects and bool(_GRIDDED_STAGES & set(model.effect(effect).stages))


def _is_adc(model: Model, name: str) -> bool:
    effect = name.partition(".")[0]
    return effect in model.effects and "adc" in model.effect(effect).stages


def tuned_steps(
    model: Model,
    parameters: Mapping[str, float],
    record: Record,
    instrument: Instrument,
    *,
    angular_gain: float | None = None,
    start: FloatArray | None = None,
) -> FloatArray:
    """Steps (P,) for ``jacobian``: those of forces and pick-off laws move this record by about ``_SHARE`` of its level.

    Arguments as in ``forward``.
    """
    play = play_of([record], instrument, angular_gain)
    x0 = model.to_internal(model.complete(parameters))
    steps = model.steps(x0)
    base = assemble(model, model.to_values(x0), instrument, play.conditions)
    # One substep tells how far a step goes.
    rough = partial(remainder_volts, play=play, starts=[start], substeps=1)
    r0 = rough(base)
    level = float(np.sqrt(np.mean((linear_volts(base, play, [start]) + r0) ** 2)))

    def share(i: int, step: float) -> float:
        x = x0.copy()
        x[i] += step if x0[i] + step <= model.bounds(model.free[i])[1] else -step
        try:
            r = rough(assemble(model, model.to_values(x), instrument, play.conditions))
        except ConfigError:
            return np.inf
        return float(np.sqrt(np.mean((r - r0) ** 2))) / max(level, 1e-300)

    for i, name in enumerate(model.free):
        if is_gridded(model, name):
            steps[i] = _tuned(
                partial(share, i), float(steps[i]), 0.25 * (model.bounds(name)[1] - model.bounds(name)[0])
            )
    return steps


def _tuned(share: Callable[[float], float], step: float, most: float) -> float:
    """The step whose share of the record is about ``_SHARE``."""
    for _ in range(12):
        found = share(step)
        if found == 0.0 or 0.01 * _SHARE <= found <= 10.0 * _SHARE:
            break
        step = min(step * (1e-3 if not np.isfinite(found) else float(np.clip(_SHARE / found, 1e-6, 1e6))), most)
    return step


def jacobian(
    model: Model,
    parameters: Mapping[str, float],
    record: Record,
    instrument: Instrument,
    *,
    angular_gain: float | None = None,
    start: FloatArray | None = None,
    exact: bool = False,
    steps: FloatArray | None = None,
) -> FloatArray:
    """dy/dx (N, S, P) at ``parameters``; x are the smooth coordinates of ``model.free`` (``model.to_internal``).

    Parameters
    ----------
    model, parameters, record, instrument, angular_gain, start : as in ``forward``.
    exact : plant columns through the integrator too.
    steps : (P,) of the differences; ``None`` is ``tuned_steps``.

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    channels_checked(model, record)
    if steps is None:
        steps = tuned_steps(model, parameters, record, instrument, angular_gain=angular_gain, start=start)
    play = play_of([record], instrument, angular_gain)
    columns = play_jacobian(model, parameters, play, instrument, steps, starts=[start], exact=exact)
    return np.moveaxis(columns[:, 0], 0, -1)


#: dy/dx (R, N, S) of parameters of forces and pick-off laws, by their place among the free ones.
Bent = Mapping[int, FloatArray]


def bent_columns(
    model: Model,
    parameters: Mapping[str, float],
    play: Play,
    instrument: Instrument,
    steps: FloatArray,
    places: Sequence[int],
    starts: Starts | None = None,
) -> Bent:
    """What free parameters at ``places`` move in the remainder; arguments as in ``play_jacobian``."""
    if not places:
        return {}
    x0 = model.to_internal(model.complete(parameters))
    base = assemble(model, model.to_values(x0), instrument, play.conditions)
    remainder = remainder_volts(base, play, starts, SLOPE_SUBSTEPS)
    serial = replace(play, threads=1)

    def column(i: int) -> FloatArray:
        # Deviations are free of cancellation: one side is enough, inside the range.
        name, step = model.free[i], float(steps[i])
        step = step if "." not in name or x0[i] + step <= model.bounds(name)[1] else -step
        x = x0.copy()
        x[i] += step
        system = assemble(model, model.to_values(x), instrument, play.conditions)
        change = remainder_volts(system, serial, starts, SLOPE_SUBSTEPS)
        change -= remainder
        return np.divide(change, step, out=change)

    # Parameters are shared out among the threads; within one of them records follow each other.
    return dict(zip(places, mapped(column, places, play.threads)))


def play_jacobian(
    model: Model,
    parameters: Mapping[str, float],
    play: Play,
    instrument: Instrument,
    steps: FloatArray,
    *,
    starts: Starts | None = None,
    exact: bool = False,
    bent: Bent | None = None,
) -> FloatArray:
    """dy/dx (P, R, N, S) of the records of a play; arguments as in ``jacobian``, one start a record.

    ``bent`` gives the columns of forces and pick-off laws where they are known.

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    x0 = model.to_internal(model.complete(parameters))
    base = assemble(model, model.to_values(x0), instrument, play.conditions)
    if bent is None:
        curved = exact and bool(base.forces or base.senses)
        own = [i for i, name in enumerate(model.free) if is_gridded(model, name)]
        asked = [i for i, name in enumerate(model.free) if curved and not _is_adc(model, name)]
        bent = bent_columns(model, parameters, play, instrument, steps, asked or own, starts)
    known = bent
    serial = replace(play, threads=1)
    clipped = volts(base, play, starts) if base.adcs else None
    columns = np.zeros((x0.size, len(play.drives), play.drives[0].shape[0], base.sense_motion.shape[0]))

    def system(i: int, value: float) -> System:
        x = x0.copy()
        x[i] = value
        return assemble(model, model.to_values(x), instrument, play.conditions)

    def behind(i: int, value: float) -> FloatArray:
        assert clipped is not None
        return converted(system(i, value), clipped)

    def linear(i: int, value: float) -> FloatArray:
        return linear_volts(system(i, value), serial, starts)

    def column(i: int) -> None:
        name, step = model.free[i], float(steps[i])
        own = model.bounds(name)
        if _is_adc(model, name):
            columns[i] = _slope(partial(behind, i), x0[i], step, *own)
            return
        if not is_gridded(model, name):
            columns[i] = _slope(partial(linear, i), x0[i], step, *(own if "." in name else (-np.inf, np.inf)))
        if i in known:
            columns[i] += known[i]

    mapped(column, range(x0.size), play.threads)
    if clipped is not None:
        # Behind the converter a sample that is clipped does not move.
        moved = (converted(base, clipped * (1.0 + 1e-7)) - converted(base, clipped * (1.0 - 1e-7))) / 2e-7
        passes = np.where(clipped != 0.0, moved / np.where(clipped != 0.0, clipped, 1.0), 1.0)
        for i, name in enumerate(model.free):
            if not _is_adc(model, name):
                columns[i] *= passes
    return columns


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
    loudest = max(range(len(play.drives)), key=lambda r: float(np.mean(play.drives[r] ** 2)))
    # One substep on the loudest record tells how far a step goes.
    rough = moving(alone(play, loudest), None if starts is None else [starts[loudest]], 1) if bends else None
    t = np.arange(y0.shape[1]) / play.sample_rate_hz
    context = assemble(model, values, instrument, play.conditions).context

    steps = dict(step_hints or {})
    level = float(np.sqrt(np.mean(y0**2)))
    for at in product(*grids):
        point = {m.name: value for m, value in zip(scanned, at)}
        basis = np.zeros((y0.shape[1], 0))
        names: tuple[str, ...] = ()
        if found.disturbance is not None:
            basis = found.disturbance(t, np.array([point.get(m.name, m.null) for m in members]), context)
            columns = np.zeros((0, *y0.shape))
        elif not followed:
            columns = moved(point, scanned[0].name, point[scanned[0].name])[None]
            names = tuple(m.name for m in scanned)
        else:
            for m in followed:
                if rough is not None and m.name not in steps:
                    step, _ = _stepped(m, point, rough[1], float(np.sqrt(np.mean(rough[0] ** 2))), 0.0, False)
                    steps[m.name] = step
            slopes = [_derivative(m, point, moved, level, steps.get(m.name, 0.0), not bends) for m in followed]
            columns = np.stack([slope for slope, _ in slopes])
            names = tuple(m.name for m in followed)
            steps = {**steps, **{m.name: step for m, (_, step) in zip(followed, slopes)}}
        yield Signature(effect, names, point, columns, basis, dict(steps))


_Moved = Callable[[Mapping[str, float], str, float], FloatArray]


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
    """A step that moves the records by about ``_SHARE`` of their level, and that change (R, N, S).

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
            found = float(np.sqrt(np.mean(first**2))) / max(level, 1e-300)
        except ConfigError:
            found = np.inf
        if found == 0.0 or shortest * _SHARE <= found <= longest * _SHARE:
            break
        step = min(step * (1e-3 if not np.isfinite(found) else float(np.clip(_SHARE / found, 1e-6, 1e6))), most)
    else:
        if found > longest * _SHARE:
            raise ConfigError("the record jumps at the null of a parameter", value=member.name)
    return step, first
