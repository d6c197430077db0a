"""Derivatives of the record to the parameters of a model.

Central differences in the model's smooth coordinates through the exact bank, one-sided of second order where a range
ends; one-sided ones through the integrator for forces and pick-off laws, whose deviation is free of cancellation.
With strong nonlinear effects ``exact`` adds the remainder's share to the columns of the plant and of linear effects
too.

Shapes: R records, N samples, S senses, P free parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...errors import ConfigError, MeasurementError
from ...threads import mapped
from ..instrument import Instrument
from ..record import Record
from .drive_groups import DriveGroup, drive_group_of
from .response import Starts, converted, linear_volts, nonlinear_response, volts
from .system import System, assemble

#: A step of an effect's parameter moves the record by about this share.
SHARE = 1e-6
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


def is_integrated(model: Model, name: str) -> bool:
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
    """Steps (P,) for ``jacobian``: those of forces and pick-off laws move this record by about ``SHARE`` of its level.

    Arguments as in ``forward``.
    """
    group = drive_group_of([record], instrument, angular_gain)
    x0 = model.to_internal(model.complete(parameters))
    steps = model.steps(x0)
    base = assemble(model, model.to_values(x0), instrument, group.conditions)
    # One substep tells how far a step goes.
    rough = partial(nonlinear_response, group=group, starts=[start], substeps=1)
    r0 = rough(base)
    level = float(np.sqrt(np.mean((linear_volts(base, group, [start]) + r0) ** 2)))

    def share(i: int, step: float) -> float:
        x = x0.copy()
        x[i] += step if x0[i] + step <= model.bounds(model.free[i])[1] else -step
        try:
            r = rough(assemble(model, model.to_values(x), instrument, group.conditions))
        except ConfigError:
            return np.inf
        return float(np.sqrt(np.mean((r - r0) ** 2))) / max(level, 1e-300)

    for i, name in enumerate(model.free):
        if is_integrated(model, name):
            steps[i] = _tuned(
                partial(share, i), float(steps[i]), 0.25 * (model.bounds(name)[1] - model.bounds(name)[0])
            )
    return steps


def _tuned(share: Callable[[float], float], step: float, most: float) -> float:
    """The step whose share of the record is about ``SHARE``."""
    for _ in range(12):
        found = share(step)
        if found == 0.0 or 0.01 * SHARE <= found <= 10.0 * SHARE:
            break
        step = min(step * (1e-3 if not np.isfinite(found) else float(np.clip(SHARE / found, 1e-6, 1e6))), most)
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
    group = drive_group_of([record], instrument, angular_gain)
    columns = group_jacobian(model, parameters, group, instrument, steps, starts=[start], exact=exact)
    return np.moveaxis(columns[:, 0], 0, -1)


#: dy/dx (R, N, S) of parameters of forces and pick-off laws, by their place among the free ones.
NonlinearColumns = Mapping[int, FloatArray]


def nonlinear_columns(
    model: Model,
    parameters: Mapping[str, float],
    group: DriveGroup,
    instrument: Instrument,
    steps: FloatArray,
    places: Sequence[int],
    starts: Starts | None = None,
) -> NonlinearColumns:
    """What free parameters at ``places`` move in the remainder; arguments as in ``play_jacobian``."""
    if not places:
        return {}
    x0 = model.to_internal(model.complete(parameters))
    base = assemble(model, model.to_values(x0), instrument, group.conditions)
    remainder = nonlinear_response(base, group, starts, SLOPE_SUBSTEPS)
    serial = replace(group, threads=1)

    def column(i: int) -> FloatArray:
        # Deviations are free of cancellation: one side is enough, inside the range.
        name, step = model.free[i], float(steps[i])
        step = step if "." not in name or x0[i] + step <= model.bounds(name)[1] else -step
        x = x0.copy()
        x[i] += step
        system = assemble(model, model.to_values(x), instrument, group.conditions)
        change = nonlinear_response(system, serial, starts, SLOPE_SUBSTEPS)
        change -= remainder
        return np.divide(change, step, out=change)

    # Parameters are shared out among the threads; within one of them records follow each other.
    return dict(zip(places, mapped(column, places, group.threads)))


def group_jacobian(
    model: Model,
    parameters: Mapping[str, float],
    group: DriveGroup,
    instrument: Instrument,
    steps: FloatArray,
    *,
    starts: Starts | None = None,
    exact: bool = False,
    nonlinear: NonlinearColumns | None = None,
) -> FloatArray:
    """dy/dx (P, R, N, S) of the records of a play; arguments as in ``jacobian``, one start a record.

    ``nonlinear`` gives the columns of forces and pick-off laws where they are known.

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    x0 = model.to_internal(model.complete(parameters))
    base = assemble(model, model.to_values(x0), instrument, group.conditions)
    if nonlinear is None:
        curved = exact and bool(base.forces or base.senses)
        free = enumerate(model.free)
        asked = [i for i, name in free if is_integrated(model, name) or (curved and not _is_adc(model, name))]
        nonlinear = nonlinear_columns(model, parameters, group, instrument, steps, asked, starts)
    known = nonlinear
    serial = replace(group, threads=1)
    clipped = volts(base, group, starts) if base.adcs else None
    columns = np.zeros((x0.size, len(group.drives), group.drives[0].shape[0], base.sense_motion.shape[0]))

    def system(i: int, value: float) -> System:
        x = x0.copy()
        x[i] = value
        return assemble(model, model.to_values(x), instrument, group.conditions)

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
        if not is_integrated(model, name):
            columns[i] = _slope(partial(linear, i), x0[i], step, *(own if "." in name else (-np.inf, np.inf)))
        if i in known:
            columns[i] += known[i]

    mapped(column, range(x0.size), group.threads)
    if clipped is not None:
        # Behind the converter a sample that is clipped does not move.
        moved = (converted(base, clipped * (1.0 + 1e-7)) - converted(base, clipped * (1.0 - 1e-7))) / 2e-7
        passes = np.where(clipped != 0.0, moved / np.where(clipped != 0.0, clipped, 1.0), 1.0)
        for i, name in enumerate(model.free):
            if not _is_adc(model, name):
                columns[i] *= passes
    return columns
