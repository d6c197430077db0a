"""Signatures of absent effects: how records move with their parameters, at the null.

One-sided differences where a deviation is integrated, which is free of cancellation; central ones where the change is a
difference of two records.

Shapes: R records, N samples, S senses, k parameters of an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np

from ...arrays import FloatArray
from ...device.effect import Effect
from ...device.model import Model
from ...device.parameters import Parameter
from ...errors import ConfigError
from ..instrument import Instrument
from .drive_groups import DriveGroup, highest_drive_energy, single_record_group
from .integrate import Motion
from .response import Starts, converted, first_order_response, linear_motions, linear_volts, nonlinear_response
from .sensitivity import SHARE, SLOPE_SUBSTEPS, STRONG
from .system import System, assemble

#: Numbers that the trajectories of a base may take.
_ROOM = 2e7


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


@dataclass(frozen=True, eq=False)
class Base:
    """The records of a play without any absent effect: what signatures are differences to.

    Parameters
    ----------
    model, values, play, instrument : what is played on what, at complete parameters.
    starts : the state of each record at its first sample where it does not start at rest.
    substeps : of the integrator.
    system : assembled.
    linear : (R, N, S) [V].
    remainder : (R, N, S) [V], ``None`` where the model has no forces and no pick-off laws.
    """

    model: Model
    values: Mapping[str, float]
    group: DriveGroup
    instrument: Instrument
    starts: Starts | None
    substeps: int
    system: System
    linear: FloatArray
    remainder: FloatArray | None

    @cached_property
    def y(self) -> FloatArray:
        """(R, N, S) [V]."""
        return self.linear if self.remainder is None else self.linear + self.remainder

    @cached_property
    def level(self) -> float:
        """rms of the records [V]."""
        return _rms(self.y)

    @cached_property
    def strong(self) -> bool:
        """Whether the remainder changes what a linear effect does; a weak one does so in second order only."""
        if self.remainder is None:
            return False
        return bool(np.linalg.norm(self.remainder) > STRONG * np.linalg.norm(self.linear))

    @cached_property
    def motions(self) -> list[Motion] | None:
        """Linear trajectories; ``None`` where the model is not linear, or they would take too much memory."""
        states = 2 * self.system.mechanics.stiffness.shape[1] * 2 * self.substeps
        if self.remainder is not None or states * self.group.waveforms.shape[1] * len(self.group.drives) > _ROOM:
            return None
        return linear_motions(self.system, self.group, self.starts, self.substeps)

    @cached_property
    def rough(self) -> Base:
        """The loudest record, one substep a sample: it tells how far a step goes."""
        record = highest_drive_energy(self.group.drives)
        starts = None if self.starts is None else [self.starts[record]]
        return base_of(self.model, self.values, single_record_group(self.group, record), self.instrument, starts, 1)


def base_of(
    model: Model,
    parameters: Mapping[str, float],
    group: DriveGroup,
    instrument: Instrument,
    starts: Starts | None = None,
    substeps: int = SLOPE_SUBSTEPS,
) -> Base:
    """The records of ``play`` at ``parameters`` of ``model``; arguments as in ``Base`` and ``forward``.

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    values = model.complete(parameters)
    system = assemble(model, values, instrument, group.conditions)
    linear = linear_volts(system, group, starts)
    remainder = nonlinear_response(system, group, starts, substeps) if system.forces or system.senses else None
    return Base(model, values, group, instrument, starts, substeps, system, linear, remainder)


def signatures(
    base: Base,
    effect: str,
    *,
    grid: Mapping[str, tuple[float, ...]] | None = None,
    step_hints: Mapping[str, float] | None = None,
) -> Iterator[Signature]:
    """Signatures of the absent ``effect`` in the records of ``base``.

    One where all its parameters exist at the null; else one a point of the grid of those that do not (the product
    over them).

    Parameters
    ----------
    base : the records without it.
    effect : name of an effect that is not in the model.
    grid : parameter -> values to scan instead of the declared grid.
    step_hints : parameter -> a step to begin with, such as ``Signature.steps`` of a like play.

    Raises
    ------
    ConfigError : the effect is unknown, makes no sense for the plant, or is in the model already.
    """
    model = base.model
    if effect in model.effects:
        raise ConfigError("effect is in the model already", value=effect, allowed=", ".join(model.candidates()))
    larger = model.with_effect(effect)
    found = larger.effect(effect)
    members = found.members(larger.built.shape)
    scanned = [m for m in members if m.grid]
    followed = [m for m in members if not m.grid]
    grids = [(grid or {}).get(m.name, m.grid) for m in scanned]
    bends = found.force is not None or found.sense is not None
    moved = partial(_moved, base, larger, found)
    steps = dict(step_hints or {})
    unknown = [m for m in followed if bends and m.name not in steps]
    for at in product(*grids):
        point = {m.name: value for m, value in zip(scanned, at)}
        basis = np.zeros((base.y.shape[1], 0))
        names: tuple[str, ...] = ()
        if found.disturbance is not None:
            t = np.arange(base.y.shape[1]) / base.group.sample_rate_hz
            p = np.array([point.get(m.name, m.null) for m in members])
            basis = found.disturbance(t, p, base.system.context)
            columns = np.zeros((0, *base.y.shape))
        elif not followed:
            columns = moved(point, scanned[0].name, point[scanned[0].name])[None]
            names = tuple(m.name for m in scanned)
        else:
            if unknown:
                rough = partial(_moved, base.rough, larger, found)
                steps |= {m.name: _stepped(m, point, rough, base.rough.level, 0.0, False)[0] for m in unknown}
                unknown = []
            slopes = [_derivative(m, point, moved, base.level, steps.get(m.name, 0.0), not bends) for m in followed]
            columns = np.stack([slope for slope, _ in slopes])
            names = tuple(m.name for m in followed)
            steps = {**steps, **{m.name: step for m, (_, step) in zip(followed, slopes)}}
        yield Signature(effect, names, point, columns, basis, dict(steps))


_Moved = Callable[[Mapping[str, float], str, float], FloatArray]


def _rms(y: FloatArray) -> float:
    return float(np.linalg.norm(y) / np.sqrt(y.size))


def _moved(base: Base, larger: Model, found: Effect, point: Mapping[str, float], name: str, value: float) -> FloatArray:
    """How the records (R, N, S) move when parameter ``name`` of the effect takes ``value`` at a ``point`` of its grid."""
    group, instrument = base.group, base.instrument
    members = found.members(larger.built.shape)
    if found.adc is not None and found.stages == ("adc",):
        p = np.array([value if m.name == name else point.get(m.name, m.null) for m in members])
        return found.adc(base.y, p, base.system.context) - base.y
    own = next(m for m in members if m.name == name)
    trial = {**base.values, **{found.full_name(m): point[m.name] for m in members if m.grid}}
    trial[found.full_name(own)] = value
    system = assemble(larger, larger.complete(trial), instrument, group.conditions)
    bends = found.force is not None or found.sense is not None
    if bends or base.strong:
        # Deviations free of cancellation: the linear part is the same unless the effect touches it.
        appends = system.mechanics.stiffness.shape != base.system.mechanics.stiffness.shape
        # Near the null only the first order of a force counts; from no effect to a point of a grid is far.
        if base.motions is not None and not own.grid and not appends:
            change = first_order_response(system, group, base.motions)
        else:
            change = nonlinear_response(system, group, base.starts, base.substeps)
        if base.remainder is not None:
            change -= base.remainder
        if set(found.stages) & {"drive", "mechanics", "readout"}:
            change += linear_volts(system, group, base.starts)
            change -= base.linear
    else:
        change = linear_volts(system, group, base.starts) - base.linear
    if system.adcs:
        change = converted(system, base.y + change) - converted(base.system, base.y)
    return change


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
