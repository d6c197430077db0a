"""A model of frequency-domain records: what the detector of each record shows at given parameters.

    Y = e^{i phi} Y_device + o             phi: phase of the reference of a lock-in, o: offset of its output (sweeps only)
    Y_i <- Y_i + a_i (Y_{i-1} - Y_i)       a detector that has not settled: a share of the row before remains,
                                           a_i = share^(dt_i / median dt), from exp(-dt / T) of a low-pass

phi and o are parameters of every sweep: no instrument states them exactly.

Shapes: N rows, S senses, D drives, P parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...device.model import Model
from ...experiment.forward.harmonic import branch, steady_motion
from ...experiment.forward.harmonic_terms import TonePoints
from ...experiment.forward.system import Conditions, System, assemble
from ...experiment.forward.tones import linear_tones
from ...experiment.tones import ToneCampaign, ToneRecord
from .steps import damping_names, difference_step, lower_bound, slope

PHASE = "phase_deg"
SETTLING = "lockin_settling"
SHARE = f"{SETTLING}.share"
#: Most motions that are kept.
_KEPT = 4


def offset_names(senses: int) -> tuple[str, ...]:
    """Names of the offsets of the output [V], in phase and in quadrature for each sense."""
    return tuple(f"offset_s{k + 1}_{part}" for k in range(senses) for part in ("x", "y"))


@dataclass(frozen=True, eq=False)
class ToneModel:
    """The records of a campaign as a function of parameters.

    Parameters
    ----------
    model : plant and effects.
    campaign : conditions, drives and frequencies.
    even : parameters whose sign a tone does not show; ``values`` hold their squares, to which the response is proportional.
    """

    model: Model
    campaign: ToneCampaign
    even: frozenset[str] = frozenset()
    _branches: dict[Hashable, dict[int, Callable[[System], ComplexArray]]] = field(default_factory=dict)

    @property
    def swept(self) -> bool:
        """Whether there is a sweep, so that phase, offset and settling apply."""
        return any(record.kind == "sweep" for record in self.campaign.records)

    @property
    def detector(self) -> tuple[str, ...]:
        """Names of the parameters of the detector that every fit has."""
        senses = self.campaign.records[0].sense_v.shape[1]
        return (PHASE, *offset_names(senses)) if self.swept else ()

    def system(self, values: Mapping[str, float], conditions: Conditions) -> System:
        """The assembled system under ``conditions``; raises ConfigError for parameters no device can have."""
        own = {
            name: math.sqrt(max(value, 0.0)) if name in self.even else value
            for name, value in values.items()
            if name in self.model.by_name
        }
        return assemble(self.model, self.model.complete(own), self.campaign.instrument, conditions)

    def predict(self, values: Mapping[str, float]) -> tuple[ComplexArray, ...]:
        """Y (N, S) [V] of every record; ``values`` hold the parameters of the model and of the detector.

        Raises
        ------
        ConfigError : parameters that no device can have.
        """
        found = []
        for system, record in zip(self._systems(values), self.campaign.records):
            if record.kind == "sweep" and (system.forces or system.senses or system.drives):
                y = steady_motion(system, _points(record)).y
            else:
                y = linear_tones(system, record.frequency_hz, record.drive_v)
            found.append(self._detected(values, record, y))
        return tuple(found)

    def linear(self, values: Mapping[str, float]) -> tuple[ComplexArray, ...]:
        """Y (N, S) [V] of every record without nonlinear effects and without a detector."""
        return tuple(
            linear_tones(system, record.frequency_hz, record.drive_v)
            for system, record in zip(self._systems(values), self.campaign.records)
        )

    def nearby(self, values: Mapping[str, float]) -> Callable[[Mapping[str, float]], tuple[ComplexArray, ...]]:
        """``predict`` at values close to ``values``: the motion of a nonlinear device stays on its branch, to first order."""
        systems = self._systems(values)
        # Absent effects are asked one after the other at the same motion.
        if len(self._branches) > _KEPT:
            self._branches.clear()
        at = self._branches.setdefault(self._acting(values), {})

        def predicted(moved: Mapping[str, float]) -> tuple[ComplexArray, ...]:
            found = []
            for k, (system, record) in enumerate(zip(self._systems(moved), self.campaign.records)):
                if record.kind == "sweep" and k not in at:
                    at[k] = branch(steady_motion(systems[k], _points(record)))
                y = at[k](system) if k in at else linear_tones(system, record.frequency_hz, record.drive_v)
                found.append(self._detected(moved, record, y))
            return tuple(found)

        return predicted

    def _acting(self, values: Mapping[str, float]) -> Hashable:
        """What determines the systems at ``values``: parameters of the plant and of the effects that act."""
        complete = {name: values.get(name, p.null) for name, p in self.model.by_name.items()}
        shape, idle = self.model.built.shape, set[str]()
        for effect in self.model.ordered_effects():
            own = [effect.full_name(member) for member in effect.members(shape)]
            if effect.is_null(np.array([complete[name] for name in own]), shape):
                idle.update(own)
        return tuple((name, value) for name, value in complete.items() if name not in idle)

    def _systems(self, values: Mapping[str, float]) -> list[System]:
        """The system of each record; records under the same conditions share one."""
        known: dict[Conditions, System] = {}
        for record in self.campaign.records:
            conditions = self._conditions(record)
            if conditions not in known:
                known[conditions] = self.system(values, conditions)
        return [known[self._conditions(record)] for record in self.campaign.records]

    def _detected(self, values: Mapping[str, float], record: ToneRecord, y: ComplexArray) -> ComplexArray:
        if record.kind != "sweep":
            return y
        offsets = np.array([values.get(name, 0.0) for name in offset_names(y.shape[1])])
        turned = y * np.exp(1.0j * np.deg2rad(values.get(PHASE, 0.0))) + offsets[::2] + 1.0j * offsets[1::2]
        share = values.get(SHARE, 0.0)
        return turned if share == 0.0 else settled(turned, record.time_s, share)

    def _conditions(self, record: ToneRecord) -> Conditions:
        bias = self.campaign.instrument.bias_v
        known = record.rate_dps is not None and (record.rate_dps == 0.0 or self.campaign.angular_gain is not None)
        rate = float(np.deg2rad(record.rate_dps or 0.0)) * (self.campaign.angular_gain or 0.0)
        own = bias if record.bias_v is None else record.bias_v
        return Conditions(own, bias, rate if known else None)

    @cached_property
    def _zetas(self) -> dict[str, str]:
        return damping_names(self.model)

    def step(self, name: str, values: Mapping[str, float], size: float) -> float:
        """Step of a difference at ``values``; ``size`` is a typical value of the parameter."""
        return difference_step(self._zetas, name, values, size)


def _points(record: ToneRecord) -> TonePoints:
    time_s = np.arange(record.frequency_hz.size, dtype=np.float64) if record.time_s is None else record.time_s
    return TonePoints(record.frequency_hz, record.drive_v, time_s - time_s[0])


def settled(y: ComplexArray, time_s: FloatArray | None, share: float) -> ComplexArray:
    """Y (N, S) of a detector in which ``share`` of the row before remains after a median interval.

    ``time_s`` (N,) [s] of the rows; intervals are equal where it is not known.
    """
    intervals = np.ones(y.shape[0] - 1) if time_s is None else np.diff(time_s)
    middle = float(np.median(intervals)) or 1.0
    kept = np.sign(share) * np.minimum(abs(share), 1.0) ** np.maximum(intervals / middle, 0.0)
    out = y.copy()
    for i, a in enumerate(kept.tolist(), 1):
        out[i] += a * (out[i - 1] - out[i])
    return out


def differences(
    model: ToneModel, values: Mapping[str, float], names: Sequence[str], sizes: Mapping[str, float]
) -> list[tuple[ComplexArray, ...]]:
    """For each of ``names`` d Y / d parameter (N, S) of every record, by differences at ``values``."""
    found, near = [], model.nearby(values)
    for name in names:
        step = model.step(name, values, sizes.get(name, 1.0))
        found.append(slope(near, values, name, step, lower_bound(model.model, model.even, name)))
    return found
