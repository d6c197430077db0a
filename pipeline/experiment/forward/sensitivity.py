"""Derivatives of a record with respect to the parameters of a model.

Parameters of linear parts: central differences of the exact linear response in the model's smooth coordinates; at the end of
a range, one-sided differences of second order.  Parameters of force and sense effects: one-sided differences of the nonlinear
response, which is free of cancellation.  If nonlinear effects are strong, ``exact`` adds the derivative of the nonlinear
response to the columns of linear parameters too.

Shapes: R records, N samples, S senses, P free parameters.  Records in volts.
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

#: A step of an effect's parameter changes the record by about this share of its rms.
SHARE = 1e-6
#: Ratio of nonlinear to linear response above which linear parameters are differentiated through the integrator too.
STRONG = 0.1
#: Substeps of the integrator for derivatives, which need less accuracy than a record.
SLOPE_SUBSTEPS = 2
_INTEGRATED_STAGES = {"force", "sense"}


def channels_checked(model: Model, record: Record) -> None:
    """Check that a record has as many drives and senses as the plant.

    Raises
    ------
    MeasurementError : it has not.
    """
    shape = model.built.shape
    found = [record.drive_v.shape[1], record.sense_v.shape[1]]
    if found != [shape.drives, shape.senses]:
        raise MeasurementError(
            f"record {record.name!r} and the plant have different numbers of drives and senses",
            value=found,
            allowed=f"{[shape.drives, shape.senses]}, as in the plant",
            next_step='write plant = { kind = "modal", modes = .. } in the model file',
        )


def _plant_slope(f: Callable[[float], FloatArray], at: float, step: float) -> FloatArray:
    """df/dx of a plant parameter, from the sides on which the damping matrix stays positive.

    Raises
    ------
    ConfigError : it is positive on no side.
    """
    for low, high in ((-np.inf, np.inf), (at, np.inf)):
        try:
            return _slope(f, at, step, low, high)
        except ConfigError:
            continue
    return _slope(f, at, step, -np.inf, at)


def _slope(f: Callable[[float], FloatArray], at: float, step: float, low: float, high: float) -> FloatArray:
    """df/dx at ``at`` to second order in ``step``, from points inside [low, high]."""
    if at - step >= low and at + step <= high:
        return (f(at + step) - f(at - step)) / (2.0 * step)
    if at - step < low:
        return (4.0 * f(at + step) - f(at + 2.0 * step) - 3.0 * f(at)) / (2.0 * step)
    return (3.0 * f(at) - 4.0 * f(at - step) + f(at - 2.0 * step)) / (2.0 * step)


def is_integrated(model: Model, name: str) -> bool:
    """Whether a parameter belongs to a force or sense effect, whose response is integrated."""
    effect = name.partition(".")[0]
    return effect in model.effects and bool(_INTEGRATED_STAGES & set(model.effect(effect).stages))


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
    """Steps (P,) for ``jacobian``, in units of x; steps of force and sense effects change the record by ``SHARE`` of its rms.

    Arguments and errors as in ``forward``.
    """
    group = drive_group_of([record], instrument, angular_gain)
    x0 = model.to_internal(model.complete(parameters))
    steps = model.steps(x0)
    base = assemble(model, model.to_values(x0), instrument, group.conditions)
    # One substep is accurate enough to choose a step.
    coarse = partial(nonlinear_response, group=group, starts=[start], substeps=1)
    r0 = coarse(base)
    level = float(np.sqrt(np.mean((linear_volts(base, group, [start]) + r0) ** 2)))

    def share(i: int, step: float) -> float:
        x = x0.copy()
        x[i] += step if x0[i] + step <= model.bounds(model.free[i])[1] else -step
        try:
            r = coarse(assemble(model, model.to_values(x), instrument, group.conditions))
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
    """A step, at most ``most``, that changes the record by about ``SHARE``; ``share`` gives the change for a step."""
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
    """dy/dx (N, S, P) at ``parameters`` [V per unit of x]; x are the smooth coordinates of ``model.free``.

    Parameters
    ----------
    model, parameters, record, instrument, angular_gain, start : as in ``forward``.
    exact : whether linear parameters are differentiated through the integrator too.
    steps : (P,) of the differences in x; ``None`` means ``tuned_steps``.

    Raises
    ------
    ConfigError, MeasurementError : as in ``forward``.
    """
    channels_checked(model, record)
    if steps is None:
        steps = tuned_steps(model, parameters, record, instrument, angular_gain=angular_gain, start=start)
    group = drive_group_of([record], instrument, angular_gain)
    columns = group_jacobian(model, parameters, group, instrument, steps, starts=[start], exact=exact)
    return np.moveaxis(columns[:, 0], 0, -1)


#: Derivatives (R, N, S) of the nonlinear response, by index of the free parameter.
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
    """Derivatives (R, N, S) [V per unit of x] of the nonlinear response with respect to the free parameters ``places``.

    The other arguments are those of ``group_jacobian``.
    """
    if not places:
        return {}
    x0 = model.to_internal(model.complete(parameters))
    base = assemble(model, model.to_values(x0), instrument, group.conditions)
    unchanged = nonlinear_response(base, group, starts, SLOPE_SUBSTEPS)
    serial = replace(group, threads=1)

    def column(i: int) -> FloatArray:
        # The nonlinear response is free of cancellation, so a one-sided difference inside the range suffices.
        name, step = model.free[i], float(steps[i])
        step = step if "." not in name or x0[i] + step <= model.bounds(name)[1] else -step
        x = x0.copy()
        x[i] += step
        system = assemble(model, model.to_values(x), instrument, group.conditions)
        change = nonlinear_response(system, serial, starts, SLOPE_SUBSTEPS)
        change -= unchanged
        return np.divide(change, step, out=change)

    # Threads work on different parameters; within a thread the records follow each other.
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
    """dy/dx (P, R, N, S) [V per unit of x] of a drive group; arguments as in ``jacobian``, with one start per record.

    ``nonlinear`` : derivatives of the nonlinear response, if they are known already (``nonlinear_columns``).

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    x0 = model.to_internal(model.complete(parameters))
    base = assemble(model, model.to_values(x0), instrument, group.conditions)
    if nonlinear is None:
        curved = exact and bool(base.forces or base.senses)
        free = enumerate(model.free)
        integrated = [i for i, name in free if is_integrated(model, name) or (curved and not _is_adc(model, name))]
        nonlinear = nonlinear_columns(model, parameters, group, instrument, steps, integrated, starts)
    known = nonlinear
    serial = replace(group, threads=1)
    before_adc = volts(base, group, starts) if base.adcs else None
    columns = np.zeros((x0.size, len(group.drives), group.drives[0].shape[0], base.sense_motion.shape[0]))

    def system(i: int, value: float) -> System:
        x = x0.copy()
        x[i] = value
        return assemble(model, model.to_values(x), instrument, group.conditions)

    def after_adc(i: int, value: float) -> FloatArray:
        assert before_adc is not None
        return converted(system(i, value), before_adc)

    def linear(i: int, value: float) -> FloatArray:
        return linear_volts(system(i, value), serial, starts)

    def column(i: int) -> None:
        name, step = model.free[i], float(steps[i])
        limits = model.bounds(name)
        if _is_adc(model, name):
            # Samples that pass the clip level within a step spoil the column: with 1e-2 of the scale, chi2 changed 50 times
            # as fast as the column said, and a clipping of SNR 384 ended as "fit failed" (bench-one 0, seed 2037).
            columns[i] = _slope(partial(after_adc, i), x0[i], 1e-6 * max(abs(x0[i]), step), *limits)
            return
        if not is_integrated(model, name):
            own = partial(linear, i)
            columns[i] = _slope(own, x0[i], step, *limits) if "." in name else _plant_slope(own, x0[i], step)
        if i in known:
            columns[i] += known[i]

    mapped(column, range(x0.size), group.threads)
    if before_adc is not None:
        # A clipped sample does not change after the ADC stage.
        slope = (converted(base, before_adc * (1.0 + 1e-7)) - converted(base, before_adc * (1.0 - 1e-7))) / 2e-7
        passes = np.where(before_adc != 0.0, slope / np.where(before_adc != 0.0, before_adc, 1.0), 1.0)
        for i, name in enumerate(model.free):
            if not _is_adc(model, name):
                columns[i] *= passes
    return columns
