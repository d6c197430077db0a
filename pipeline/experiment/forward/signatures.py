"""Signatures of absent effects: derivatives of the records with respect to the effect's parameters, at their null values.

    signature = dy/dp at p = null

Where the nonlinear response is integrated, one-sided differences suffice, because it is free of cancellation.  Where the
change is a difference of two records, central differences cancel the rounding errors that both have in common.

Shapes: R records, N samples, S senses, k parameters of an effect, L regressors of a disturbance.  Records in volts.
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
from .first_order import first_order_response, is_first_order
from .integrate import Motion
from .response import Starts, converted, linear_motions, linear_volts, nonlinear_response
from .sensitivity import SHARE, SLOPE_SUBSTEPS, STRONG
from .system import System, assemble

#: Largest number of values in the stored trajectories of a base (8 bytes each).
_MAX_STORED = 2e7


@dataclass(frozen=True, eq=False)
class Signature:
    """Change of the records with the parameters of an absent effect.

    Parameters
    ----------
    effect : its name.
    names : (k,) parameters to which ``columns`` belong.
    point : values of the parameters that are scanned over a grid.
    columns : (k, R, N, S) dy/dp at the null [V per unit of p].  If all parameters are scanned (a clip level, for example),
        the change of y from no effect to ``point`` [V].  For a disturbance k = 0.
    basis : (N, L) regressors of a disturbance; L = 0 otherwise.
    steps : step of the difference, by parameter.
    """

    effect: str
    names: tuple[str, ...]
    point: dict[str, float]
    columns: FloatArray
    basis: FloatArray
    steps: dict[str, float]


@dataclass(frozen=True, eq=False)
class Base:
    """The records of a drive group without the absent effects: the reference of the differences.

    Parameters
    ----------
    model, values, group, instrument : the model at complete parameters, and the records.
    starts : (2n,) state of each record at its first sample; ``None`` is rest.
    substeps : of the integrator, per sample.
    system : the assembled system.
    linear : (R, N, S) linear response [V].
    nonlinear : (R, N, S) nonlinear response [V]; ``None`` where the model has no force and no sense effects.
    """

    model: Model
    values: Mapping[str, float]
    group: DriveGroup
    instrument: Instrument
    starts: Starts | None
    substeps: int
    system: System
    linear: FloatArray
    nonlinear: FloatArray | None

    @cached_property
    def y(self) -> FloatArray:
        """The records (R, N, S) [V]."""
        return self.linear if self.nonlinear is None else self.linear + self.nonlinear

    @cached_property
    def level(self) -> float:
        """rms of the records [V]."""
        return _rms(self.y)

    @cached_property
    def strong(self) -> bool:
        """Whether the nonlinear response is so large that it changes the signature of a linear effect noticeably."""
        if self.nonlinear is None:
            return False
        return bool(np.linalg.norm(self.nonlinear) > STRONG * np.linalg.norm(self.linear))

    @cached_property
    def motions(self) -> list[Motion] | None:
        """Linear trajectories; ``None`` where the model is nonlinear, or they would take too much memory."""
        states = 2 * self.system.mechanics.stiffness.shape[1] * 2 * self.substeps
        if self.nonlinear is not None or states * self.group.waveforms.shape[1] * len(self.group.drives) > _MAX_STORED:
            return None
        return linear_motions(self.system, self.group, self.starts, self.substeps)

    @cached_property
    def coarse(self) -> Base:
        """The record with the highest drive energy, at one substep per sample; used to choose steps."""
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
    """The records of ``group`` at ``parameters`` of ``model``; arguments as in ``Base`` and ``forward``.

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    values = model.complete(parameters)
    system = assemble(model, values, instrument, group.conditions)
    linear = linear_volts(system, group, starts)
    nonlinear = nonlinear_response(system, group, starts, substeps) if system.forces or system.senses else None
    return Base(model, values, group, instrument, starts, substeps, system, linear, nonlinear)


def signatures(
    base: Base,
    effect: str,
    *,
    grid: Mapping[str, tuple[float, ...]] | None = None,
    step_hints: Mapping[str, float] | None = None,
) -> Iterator[Signature]:
    """Signatures of the absent ``effect`` in the records of ``base``.

    There is one signature if all parameters of the effect are identifiable at the null.  Parameters that are not (such as
    the frequency of a mode whose amplitude is zero) are scanned, with one signature for each point of the product grid.

    Parameters
    ----------
    base : the records without the effect.
    effect : name of an effect that is not in the model.
    grid : parameter -> values to scan instead of the declared grid.
    step_hints : parameter -> initial step, for example ``Signature.steps`` of another drive group.

    Raises
    ------
    ConfigError : the effect is unknown, does not fit the plant, or is in the model already; or the records are
        discontinuous at the null.
    """
    model = base.model
    if effect in model.effects:
        raise ConfigError(
            "the effect is in the model already",
            value=effect,
            allowed=", ".join(model.candidates()),
            next_step="name an effect that the model does not contain",
        )
    larger = model.with_effect(effect)
    found = larger.effect(effect)
    members = found.members(larger.built.shape)
    scanned = [m for m in members if m.grid]
    differentiated = [m for m in members if not m.grid]
    grids = [(grid or {}).get(m.name, m.grid) for m in scanned]
    integrated = found.force is not None or found.sense is not None
    change = partial(_change, base, larger, found)
    steps = dict(step_hints or {})
    unknown = [m for m in differentiated if integrated and m.name not in steps]
    for at in product(*grids):
        point = {m.name: value for m, value in zip(scanned, at)}
        basis = np.zeros((base.y.shape[1], 0))
        names: tuple[str, ...] = ()
        if found.disturbance is not None:
            t = np.arange(base.y.shape[1]) / base.group.sample_rate_hz
            p = np.array([point.get(m.name, m.null) for m in members])
            basis = found.disturbance(t, p, base.system.context)
            columns = np.zeros((0, *base.y.shape))
        elif not differentiated:
            columns = change(point, scanned[0].name, point[scanned[0].name])[None]
            names = tuple(m.name for m in scanned)
        else:
            if unknown:
                coarse = partial(_change, base.coarse, larger, found)
                steps |= {m.name: _tuned_step(m, point, coarse, base.coarse.level, 0.0, False)[0] for m in unknown}
                unknown = []
            slopes = [
                _derivative(m, point, change, base.level, steps.get(m.name, 0.0), not integrated)
                for m in differentiated
            ]
            columns = slopes[0][0][None] if len(slopes) == 1 else np.stack([slope for slope, _ in slopes])
            names = tuple(m.name for m in differentiated)
            steps = {**steps, **{m.name: step for m, (_, step) in zip(differentiated, slopes)}}
        yield Signature(effect, names, point, columns, basis, dict(steps))


_Change = Callable[[Mapping[str, float], str, float], FloatArray]


def _rms(y: FloatArray) -> float:
    return float(np.linalg.norm(y) / np.sqrt(y.size))


def _change(
    base: Base, larger: Model, found: Effect, point: Mapping[str, float], name: str, value: float
) -> FloatArray:
    """Change (R, N, S) [V] of the records when parameter ``name`` takes ``value`` at a ``point`` of the grid."""
    group, instrument = base.group, base.instrument
    members = found.members(larger.built.shape)
    if found.adc is not None and found.stages == ("adc",):
        p = np.array([value if m.name == name else point.get(m.name, m.null) for m in members])
        return found.adc(base.y, p, base.system.context) - base.y
    own = next(m for m in members if m.name == name)
    trial = {**base.values, **{found.full_name(m): point[m.name] for m in members if m.grid}}
    trial[found.full_name(own)] = value
    system = assemble(larger, larger.complete(trial), instrument, group.conditions)
    integrated = found.force is not None or found.sense is not None
    if integrated or base.strong:
        linear_stages = set(found.stages) & {"drive", "mechanics", "readout"}
        # Close to the null the first order of a force suffices; a point of a grid is far from the null.
        if base.motions is not None and not own.grid and is_first_order(system, base.system):
            change = first_order_response(system, group, base.motions)
            if system.mechanics.stiffness.shape != base.system.mechanics.stiffness.shape:
                linear_stages -= {"mechanics"}  # which appends coordinates that forces alone move
        else:
            change = nonlinear_response(system, group, base.starts, base.substeps)
        if base.nonlinear is not None:
            change -= base.nonlinear
        # The linear response changes only if the effect acts on a linear stage too.
        if linear_stages:
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
    change: _Change,
    level: float,
    hint: float,
    both_sides: bool,
) -> tuple[FloatArray, float]:
    """dy/dp (R, N, S) at the null, and the step of the difference.

    ``both_sides`` asks for a central difference, which cancels rounding errors common to two records.  It becomes
    one-sided where the range ends at the null.  The error of a one-sided difference is about ``SHARE`` of it.
    """
    step, first = _tuned_step(member, point, change, level, hint, both_sides)
    if both_sides and member.null - step >= member.low:
        return (first - change(point, member.name, member.null - step)) / (2.0 * step), step
    return np.divide(first, step, out=first), step


def _tuned_step(
    member: Parameter, point: Mapping[str, float], change: _Change, level: float, hint: float, both_sides: bool
) -> tuple[float, FloatArray]:
    """A step that changes the records by about ``SHARE`` of their rms ``level`` [V], and that change (R, N, S).

    Raises
    ------
    ConfigError : the records are discontinuous at the null (a delay after feedthrough of a stepped drive, without a filter).
    """
    most = 0.25 * (member.high - member.null)
    step = min(hint or 1e-2 * member.scale, most)
    first = np.zeros(0)
    # Central differences have an error of second order and allow larger steps; integrated responses have no rounding and
    # allow smaller ones.
    shortest, longest = (1e-2, 1e3) if both_sides and member.null - step >= member.low else (1e-4, 1e2)
    for _ in range(12):
        try:
            first = change(point, member.name, member.null + step)
            found = _rms(first) / max(level, 1e-300)
        except ConfigError:
            found = np.inf
        if found == 0.0 or shortest * SHARE <= found <= longest * SHARE:
            break
        step = min(step * (1e-3 if not np.isfinite(found) else float(np.clip(SHARE / found, 1e-6, 1e6))), most)
    else:
        if found > longest * SHARE:
            raise ConfigError(
                "the record is discontinuous at the null value of a parameter",
                value=member.name,
                next_step="declare the anti-alias filter under [instrument]",
            )
    return step, first
