"""Random sizes of hidden effects: values that are fixed first, and the direction that the strength scales.

What is drawn for an effect of the library follows from its declaration; effects outside the library are drawn here.
At size 1 the SNR on the standard campaign is roughly 100.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.effect import Effect
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.device.parameters import Parameter
from pipeline.errors import ConfigError

from .truth import HARMONICS

#: A size without a limit.  A clip level is lowered to at most this fraction of the peak: 1 / 20.
_UNLIMITED, _LARGEST_CLIP = 1e9, 20.0
#: Typical amplitude of a disturbance [V]; typical size of an effect that declares none, in scales of its parameters.
_DISTURBANCE_V, _SCALES = 3e-4, 0.1
_SHAPE = DEFAULT_COMPARE_MODEL.built.shape

#: Names of the library effects that apply to the gyro; the study hides one after the other.
LIBRARY: tuple[str, ...] = DEFAULT_COMPARE_MODEL.candidates()


@dataclass(frozen=True)
class Peak:
    """Largest absolute samples [V]: of the outputs, a lower bound of the rocking velocity |psi'|, and of the drives."""

    output_v: float
    rocking_v: float
    drive_v: float = 2.0


def peak_of(records: Sequence[FloatArray], drives: Sequence[FloatArray]) -> Peak:
    """Peaks of records (N, 2) [V] and of their drives (N, 2) [V].

    y_2 - y_1 = 2 psi_x', because the up-down motion is equal in both outputs; and |psi'| >= |psi_x'|.
    """
    output = max(float(np.abs(y).max()) for y in records)
    rocking = 0.5 * max(float(np.abs(y[:, 1] - y[:, 0]).max()) for y in records)
    return Peak(output, rocking, max(float(np.abs(v).max()) for v in drives))


@dataclass(frozen=True)
class Drawn:
    """A drawn effect: ``fixed`` values, and a ``direction`` from ``null`` (0 if absent) that a size up to ``most`` scales."""

    direction: Mapping[str, float]
    fixed: Mapping[str, float] = field(default_factory=dict)
    most: float = _UNLIMITED
    null: Mapping[str, float] = field(default_factory=dict)

    def at(self, size: float) -> dict[str, float]:
        """Values of the effect's parameters at ``size`` [1]: ``fixed``, and null + size * direction."""
        scaled = {name: size * value for name, value in self.direction.items()}
        return {**self.fixed, **scaled, **{name: value + scaled[name] for name, value in self.null.items()}}


def _clip_level(effect: Effect, peak: Peak, random: np.random.Generator) -> Drawn:
    if effect.clips("drive"):
        # The drives have one amplitude each, so that the SNR rises steeply from size 0, where the level is the peak.
        level = {effect.full_name(m): 1.0 / peak.drive_v for m in effect.members(_SHAPE)}
        return Drawn(level, most=_LARGEST_CLIP - 1.0, null=level)
    # At size 1 the level is the peak, so nothing is clipped.  Noise enters behind the clipping stage or in front of it.
    clips_noise = float(random.integers(2))
    direction = {effect.full_name(m): 1.0 / peak.output_v for m in effect.members(_SHAPE)}
    return Drawn(direction, {f"{effect.name}.clips_noise": clips_noise}, most=_LARGEST_CLIP)


def _disturbance(effect: Effect, random: np.random.Generator) -> Drawn:
    amplitude = _DISTURBANCE_V * random.uniform(0.2, 1.0, HARMONICS) / np.arange(1, HARMONICS + 1)
    direction = {f"{effect.name}.a{h + 1}": float(a) for h, a in enumerate(amplitude)}
    frequency = [m for m in effect.members(_SHAPE) if m.name == effect.mains_frequency or not effect.mains_frequency]
    return Drawn(direction, {effect.full_name(m): float(random.choice(m.grid or [m.null])) for m in frequency})


def _grid_value(member: Parameter, random: np.random.Generator) -> float:
    low, high = member.typical or (min(member.grid), max(member.grid))
    share = random.uniform()
    return float(low * (high / low) ** share) if low > 0.0 else float(low + (high - low) * share)


def _unit_vector(effect: Effect, length: int, random: np.random.Generator) -> FloatArray:
    if length == 1:
        return np.array([random.choice([-1.0, 1.0])])
    if length == 2 and any(parameter.per == "drive" for parameter in effect.parameters):
        towards = random.uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(towards), np.sin(towards)])
    vector = random.standard_normal(length)
    return np.asarray(vector / np.linalg.norm(vector))


def _sizes(effect: Effect, values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    """Draw an effect by its declared sizes: sense angle, direction of the other parameters, then values of the grids."""
    angle = effect.direction(_SHAPE)
    scaled = [m for m in effect.members(_SHAPE) if not m.grid and m != angle]
    if not scaled:
        raise ConfigError("no parameter of the effect scales its strength", value=effect.name)
    chosen = {} if angle is None else {angle.name: float(random.uniform(angle.low, angle.high))}
    vector = _unit_vector(effect, len(scaled), random)
    members = effect.members(_SHAPE)
    chosen |= {m.name: _grid_value(m, random) for m in members if m.grid and m != angle}
    fixed = {effect.full_name(m): chosen[m.name] for m in members if m.name in chosen}
    null = {effect.full_name(m): m.null for m in scaled if m.null != 0.0}
    declared = effect.size
    if declared is None:
        vector = np.where([m.low < m.null for m in scaled], vector, np.abs(vector))
        direction = {effect.full_name(m): _SCALES * m.scale * float(v) for m, v in zip(scaled, vector)}
        room = [(m.high - m.null if v > 0.0 else m.null - m.low) for m, v in zip(scaled, vector)]
        return Drawn(direction, fixed, min(r / abs(v) for r, v in zip(room, direction.values()) if v != 0.0), null)
    if not declared.signed:
        vector = np.abs(vector)
    direction = {effect.full_name(m): declared.typical * float(v) for m, v in zip(scaled, vector)}
    largest = declared.largest(values) if callable(declared.largest) else declared.largest
    reach = declared.typical if angle is not None else max(abs(v) for v in direction.values())
    return Drawn(direction, fixed, largest / reach, null)


def _motion(values: Mapping[str, float], peak_v: float) -> float:
    """Amplitude of the motion [V s] of a velocity ``peak_v`` [V] at the lower rocking frequency."""
    return peak_v / (2.0 * np.pi * values["f1_hz"])


def _preload(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    reach = _motion(values, peak.output_v) * 0.02 * 5.0 ** random.uniform()
    return Drawn({"preload.P": 0.003 * float(random.choice([-1.0, 1.0]))}, {"preload.r": float(reach)})


def _step(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    # Records last 3 s; sweeps pass the rocking modes near the middle.
    fixed = {"stiffness_step.t": random.uniform(1.0, 1.8), "stiffness_step.w": 0.005}
    return Drawn({"stiffness_step.b": 1e-6 * float(random.choice([-1.0, 1.0]))}, fixed)


def _stop(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    return Drawn({"stop.k": 100.0}, {"stop.g": float(_motion(values, peak.rocking_v) * random.uniform(0.4, 0.8))})


def _coupling(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    return Drawn({"mode_coupling.c": 3e7 * float(random.choice([-1.0, 1.0]))})


def _pumping(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    f = values["f1_hz"] + values["f2_hz"] + random.uniform(-3.0, 3.0)
    return Drawn({"parametric_pumping.h": 3e-6}, {"parametric_pumping.f": float(f)}, most=300.0)


def _heating(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    direction = {"self_heating.b": 1e-5 * float(random.choice([-1.0, 1.0]))}
    return Drawn(direction, {"self_heating.tau": float(0.02 * 15.0 ** random.uniform())})


_OUTSIDE: dict[str, Callable[[Mapping[str, float], Peak, np.random.Generator], Drawn]] = {
    "preload": _preload,
    "stiffness_step": _step,
    "stop": _stop,
    "mode_coupling": _coupling,
    "parametric_pumping": _pumping,
    "self_heating": _heating,
}


def draw_effect(
    name: str,
    values: Mapping[str, float],
    peak: Peak,
    random: np.random.Generator,
    model: Model = DEFAULT_COMPARE_MODEL,
) -> Drawn:
    """Draw the effect ``name``: one outside the library, or one that ``model`` knows.

    Parameters
    ----------
    name : of the effect.
    values : parameters of the device without the effect, by name.
    peak : of the device's records without the effect.
    random : stream of random numbers.
    model : its library holds the effect.

    Raises
    ------
    ConfigError : no such effect, or none of its parameters scales its strength.
    """
    if name in _OUTSIDE:
        return _OUTSIDE[name](values, peak, random)
    effect = model.effect(name)
    if effect.disturbance is not None:
        return _disturbance(effect, random)
    if effect.stages == ("adc",) or effect.clips("drive"):
        return _clip_level(effect, peak, random)
    return _sizes(effect, values, peak, random)
