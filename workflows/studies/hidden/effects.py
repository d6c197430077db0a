"""What is drawn for every hidden effect: what is fixed beforehand, and the direction that its strength scales.

The direction at size 1 is roughly an SNR of 100 on the standard campaign; sizes stay where the law makes sense.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import FloatArray

from .truth import HARMONICS, OUTSIDE

#: |c12| stays below this share of sqrt(c11 c22); a converter keeps this inverse level at least [1/V].
_PASSIVE, _LONGEST = 0.9, 1e9


@dataclass(frozen=True)
class Peak:
    """Largest samples [V]: of the outputs, and of the rocking velocity |psi'|, which is that at least."""

    output_v: float
    rocking_v: float


def peak_of(records: Sequence[FloatArray]) -> Peak:
    """Of records (N, 2):  y_2 - y_1 = 2 psi_x',  and |psi'| >= |psi_x'|; the up-down motion is the same in both outputs."""
    output = max(float(np.abs(y).max()) for y in records)
    return Peak(output, 0.5 * max(float(np.abs(y[:, 1] - y[:, 0]).max()) for y in records))


@dataclass(frozen=True)
class Drawn:
    """``fixed`` and ``direction`` by parameter; sizes up to ``most``."""

    direction: Mapping[str, float]
    fixed: Mapping[str, float] = field(default_factory=dict)
    most: float = _LONGEST

    def at(self, size: float) -> dict[str, float]:
        """The values of the effect's parameters at ``size``."""
        return {**self.fixed, **{name: size * value for name, value in self.direction.items()}}


#: Parameter -> (size, whether it may have either sign, largest value that makes sense) of the plain effects.
_PLAIN: dict[str, tuple[tuple[str, ...], float, bool, float]] = {
    "nonlinear_damping": (("d",), 3e-3, False, 10.0),
    "damping_drift": (("gamma",), 2e-3, False, 1.0),
    "frequency_drift": (("beta",), 1e-6, True, 1e-2),
    "cubic_stiffness": (("k3",), 1e8, True, 1e12),
    "quadratic_stiffness": (("k2x", "k2y"), 3e7, True, 1e11),
    "electrostatic_softening": (("1/g",), 50.0, False, 500.0),
    "angular_rate": (("Omega",), 7e-3, True, 50.0),
    "updown_tilt": (("t_x",), 2e-3, True, 0.5),
    "electrode_misalignment": (("phi",), 0.1, True, 20.0),
    "electrode_mismatch": (("m_D", "m_S"), 2e-3, True, 0.3),
    "drive_nonlinearity": (("eps",), 0.3, False, 2.0),
    "sense_nonlinearity": (("1/g",), 2.0, False, 500.0),
    "capacitive_feedthrough": (("C_s1d1", "C_s1d2", "C_s2d1", "C_s2d2"), 1e-7, True, 1e-3),
    "resistive_feedthrough": (("R_s1d1", "R_s1d2", "R_s2d1", "R_s2d2"), 3e-4, True, 1.0),
    "pickoff_crosstalk": (("a", "b"), 1e-3, True, 0.5),
    "pickoff_pole": (("T",), 5e-7, False, 1e-3),
    "loop_delay": (("tau",), 5e-7, False, 1e-3),
    "gain_drift": (("gamma",), 5e-4, True, 0.2),
}


def _plain(effect: str, random: np.random.Generator) -> Drawn:
    names, size, either, largest = _PLAIN[effect]
    vector = random.standard_normal(len(names)) if len(names) > 1 else np.array([random.choice([-1.0, 1.0])])
    vector = vector / np.linalg.norm(vector)
    if not either:
        vector = np.abs(vector)
    direction = {f"{effect}.{name}": size * float(v) for name, v in zip(names, vector)}
    return Drawn(direction, most=largest / max(abs(v) for v in direction.values()))


def _damping(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    c11, c22 = (4.0 * np.pi * values[f"f{i}_hz"] * values[f"zeta{i}"] for i in (1, 2))
    size = 0.02 * float(random.choice([-1.0, 1.0]))
    return Drawn({"c12_per_s": size}, most=float(_PASSIVE * np.sqrt(c11 * c22)) / abs(size))


def _parasitic(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    angle, towards = random.uniform(-90.0, 90.0), random.uniform(0.0, 2.0 * np.pi)
    fixed = {
        "parasitic_mode.f": float(300.0 * (2500.0 / 300.0) ** random.uniform()),
        "parasitic_mode.zeta": float(5e-4 * 40.0 ** random.uniform()),
        "parasitic_mode.a": float(angle),
    }
    b = {"parasitic_mode.b_d1": float(np.cos(towards)), "parasitic_mode.b_d2": float(np.sin(towards))}
    return Drawn(b, fixed, most=900.0)


def _saturation(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    # Size 1 clips nothing yet.  Noise enters behind the stage that clips, or in front of it.
    before = float(random.integers(2))
    return Drawn({"adc_saturation.1/level": 1.0 / peak.output_v}, {"adc_saturation.clips_noise": before}, most=20.0)


def _hum(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    amplitude = 3e-4 * random.uniform(0.2, 1.0, HARMONICS) / np.arange(1, HARMONICS + 1)
    direction = {f"mains_hum.a{h + 1}": float(a) for h, a in enumerate(amplitude)}
    return Drawn(direction, {"mains_hum.f": float(random.choice([50.0, 60.0]))})


def _friction(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    return Drawn({"coulomb_friction.F": 0.01}, {"coulomb_friction.s": peak.output_v * 0.005 * 4.0 ** random.uniform()})


def _motion(values: Mapping[str, float], peak_v: float) -> float:
    return peak_v / (2.0 * np.pi * values["f1_hz"])


def _hysteresis(values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    reach = _motion(values, peak.output_v) * 0.05 * 6.0 ** random.uniform()
    return Drawn({"hysteresis.k": 10.0}, {"hysteresis.r": float(reach)})


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


_OWN: dict[str, Callable[[Mapping[str, float], Peak, np.random.Generator], Drawn]] = {
    "offdiagonal_damping": _damping,
    "parasitic_mode": _parasitic,
    "adc_saturation": _saturation,
    "mains_hum": _hum,
    "coulomb_friction": _friction,
    "hysteresis": _hysteresis,
    "stop": _stop,
    "mode_coupling": _coupling,
    "parametric_pumping": _pumping,
    "self_heating": _heating,
}

#: The library effects that are hidden in turn.
LIBRARY: tuple[str, ...] = tuple(sorted({*_PLAIN, *_OWN} - set(OUTSIDE)))


def draw_effect(effect: str, values: Mapping[str, float], peak: Peak, random: np.random.Generator) -> Drawn:
    """``effect`` on the device with ``values``, whose records have this ``peak`` without it."""
    return _OWN[effect](values, peak, random) if effect in _OWN else _plain(effect, random)
