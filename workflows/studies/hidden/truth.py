"""Independent simulator of hidden-effect campaigns: a gyro and its read-out, written from the equations alone.

    psi'' + C psi' + K psi = G_r M_D K_D f,   z'' + c33 z' + omega3^2 z = G_z (1, 1) K_D f
    S = K_S (M_S psi' + (1, 1)^T z')

It shares no law with the effects under test: ``STATED`` names the library effects whose laws are stated here a second time,
``OUTSIDE`` the physics that no library effect has.  A new effect needs no entry here; without one, its own law is simulated
(``own_law``).  To state its law a second time: add its term to ``Physics`` and ``slope`` in ``integrator``, its parameters
to ``physics``, and its name to ``STATED``.

Values are by name: "effect.parameter", and the parameters of the plant.  Units: SI, angles in degrees.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ConfigError
from pipeline.experiment.instrument import Instrument

from .integrator import COORDINATES, integrate
from .physics import Physics
from .readout import is_apart, read_out

#: Integration steps per sample; at 10 kHz the error of a record is below 1e-8 of its signal.
STEPS = 2

#: Number of harmonics of a hidden hum.
HARMONICS = 5

_STATED = """
adc_saturation angular_rate capacitive_feedthrough channel_delay channel_pole charge_drift clock_offset
coulomb_friction cubic_damping cubic_stiffness damping_drift drive_delay drive_nonlinearity drive_pole
drive_saturation electrode_misalignment electrode_mismatch electrostatic_softening frequency_drift gain_drift
hysteresis internal_resonance_1_2 internal_resonance_1_3 levitation_force loop_delay mains_hum nonlinear_damping
offdiagonal_damping parasitic_mode pickoff_crosstalk pickoff_pole quadratic_stiffness resistive_feedthrough
sense_nonlinearity squeeze_film_damping updown_tilt weakening_damping
"""
#: Library effects whose law is stated here.
STATED: frozenset[str] = frozenset(_STATED.split())

#: Physics outside the library: name -> law.
OUTSIDE: dict[str, str] = {
    "stiffness_step": "K (1 + b (1 + tanh((t - t0)/w))/2): K steps within a record",
    "preload": "psi'' -= P psi / sqrt(|psi|^2 + r^2)",
    "stop": "psi'' -= k (1 - g/|psi|) psi where |psi| > g",
    "mode_coupling": "potential c psi_x^2 psi_y",
    "parametric_pumping": "K (1 + h cos(2 pi f t))",
    "self_heating": "K (1 + b T),  T' = |psi'|^2 - T/tau",
}


def _rotated(axis_deg: float, first: float, second: float, cross: float = 0.0) -> FloatArray:
    """The symmetric tensor (2, 2) with components ``first``, ``second`` and ``cross`` in axes rotated by ``axis_deg``."""
    c, s = math.cos(math.radians(axis_deg)), math.sin(math.radians(axis_deg))
    axes = np.array([[c, -s], [s, c]])
    return np.asarray(axes @ np.array([[first, cross], [cross, second]]) @ axes.T)


def physics(values: Mapping[str, float], instrument: Instrument) -> Physics:
    """The coefficients (SI units) of the equations of motion at ``values`` by name; an effect without values is absent.

    Raises
    ------
    ConfigError : the simulator does not support the instrument.
    """
    filter_ = instrument.antialias
    if instrument.hold != "zoh" or filter_ is None or filter_.order != 8:
        raise ConfigError("hidden campaigns need zero-order hold and an anti-alias filter of order 8", value=instrument)

    def of(name: str) -> float:
        return float(values.get(name, 0.0))

    omega = [2.0 * math.pi * values[f"f{i}_hz"] for i in (1, 2, 3)]
    loss = [2.0 * values[f"zeta{i}"] * w for i, w in zip((1, 2, 3), omega)]
    n = COORDINATES
    stiffness, damping = np.eye(n), np.zeros((n, n))
    stiffness[:2, :2] = _rotated(values["theta_deg"], omega[0] ** 2, omega[1] ** 2)
    damping[:2, :2] = _rotated(values["theta_deg"], loss[0], loss[1], of("c12_per_s"))
    stiffness[2, 2], damping[2, 2] = omega[2] ** 2, loss[2]
    gyroscopic = np.zeros((n, n))
    gyroscopic[0, 1], gyroscopic[1, 0] = -2.0 * of("angular_rate.Omega"), 2.0 * of("angular_rate.Omega")
    if "parasitic_mode.f" in values:
        own = 2.0 * math.pi * values["parasitic_mode.f"]
        stiffness[3, 3], damping[3, 3] = own**2, 2.0 * values["parasitic_mode.zeta"] * own

    sign = np.array([-1.0, 1.0])
    d, s = values["drive_imbalance"], values["sense_imbalance"]
    torque_gain = 1.0 + sign * (d + of("electrode_mismatch.m_D"))
    rocking_sense = 1.0 + sign * (s + of("electrode_mismatch.m_S"))
    phi, tilt = math.radians(of("electrode_misalignment.phi")), of("updown_tilt.t_x")
    lever = np.array([[-1.0, 1.0], [1.0, 1.0]])
    rotation = np.array([[math.cos(phi), -math.sin(phi)], [math.sin(phi), math.cos(phi)]])
    drive = np.zeros((n, 2))
    drive[:2] = values["rocking_gain"] * rotation @ lever * torque_gain
    drive[2] = values["updown_gain"] * (1.0 - tilt * lever[0]) * (1.0 + sign * d)
    drive[3] = of("parasitic_mode.b_d1"), of("parasitic_mode.b_d2")
    rocking = np.array([[-1.0, -1.0], [1.0, -1.0]])
    sense = np.zeros((2, n))
    sense[:, :2] = rocking_sense[:, None] * rocking
    sense[:, 2] = (1.0 + sign * s) * np.array([1.0 + tilt, 1.0 - tilt])
    if "parasitic_mode.f" in values:
        angle = math.radians(values["parasitic_mode.a"])
        sense[:, 3] = math.cos(angle), math.sin(angle)
    drive_motion, sense_motion = np.zeros((2, n)), np.zeros((2, n))
    drive_motion[:, :2], sense_motion[:, :2] = lever.T, rocking
    drive_motion[:, 2] = sense_motion[:, 2] = 1.0

    def paths(effect: str, symbol: str) -> FloatArray:
        return np.array([[of(f"{effect}.{symbol}_s{i}d{j}") for j in (1, 2)] for i in (1, 2)])

    corner = 2.0 * math.pi * filter_.corner_hz
    return Physics(
        stiffness=stiffness,
        damping=damping,
        gyroscopic=gyroscopic,
        drive=drive,
        sense=sense,
        drive_motion=drive_motion,
        sense_motion=sense_motion,
        crosstalk=np.array([[1.0, of("pickoff_crosstalk.a")], [of("pickoff_crosstalk.b"), 1.0]]),
        resistive=paths("resistive_feedthrough", "R"),
        capacitive=paths("capacitive_feedthrough", "C"),
        filter_damping=np.array([2.0 * math.sin((2 * j - 1) * math.pi / 16.0) * corner for j in range(1, 5)]),
        filter_square=corner**2,
        bias_v=float(instrument.bias_v),
        swing_v=1.0 / max(of("drive_saturation.1/level"), 1e-300),
        square_law=of("drive_nonlinearity.eps"),
        inverse_drive_gap=of("electrostatic_softening.1/g"),
        inverse_sense_gap=of("sense_nonlinearity.1/g"),
        stiffness_drift=of("frequency_drift.beta"),
        damping_drift=of("damping_drift.gamma"),
        gain_drift=of("gain_drift.gamma"),
        cubic=of("cubic_stiffness.k3"),
        quadratic_x=of("quadratic_stiffness.k2x"),
        quadratic_y=of("quadratic_stiffness.k2y"),
        drag=of("nonlinear_damping.d"),
        cubic_drag=of("cubic_damping.d"),
        film=of("squeeze_film_damping.1/g^2"),
        weakening=of("weakening_damping.1/s"),
        friction=of("coulomb_friction.F"),
        friction_speed=float(values.get("coulomb_friction.s", 1.0)),
        pickoff_time_s=of("pickoff_pole.T"),
        delay_s=of("loop_delay.tau"),
        hysteresis=of("hysteresis.k"),
        hysteresis_reach=float(values.get("hysteresis.r", 1.0)),
        stop=of("stop.k"),
        stop_gap=of("stop.g"),
        coupling=of("mode_coupling.c"),
        pump=of("parametric_pumping.h"),
        pump_omega=2.0 * math.pi * of("parametric_pumping.f"),
        heating=of("self_heating.b"),
        cooling_per_s=1.0 / float(values.get("self_heating.tau", 1.0)),
        preload=of("preload.P"),
        preload_reach=float(values.get("preload.r", 1.0)),
        step=of("stiffness_step.b"),
        step_s=of("stiffness_step.t"),
        step_width_s=float(values.get("stiffness_step.w", 1.0)),
        fringe=of("levitation_force.eps"),
        charging=of("charge_drift.gamma"),
        softened_share=of("charge_drift.kappa"),
        hidden=np.array(
            [
                [math.sqrt(of(f"{name}.c^2")), ratio * omega[0] * (1.0 + of(f"{name}.delta")), of(f"{name}.zeta")]
                for name, ratio in (("internal_resonance_1_2", 2.0), ("internal_resonance_1_3", 3.0))
            ]
        ),
    )


def response(
    values: Mapping[str, float], drive_v: FloatArray, instrument: Instrument, steps: int = STEPS
) -> FloatArray:
    """The noise-free record (N, 2) [V] of a device that starts at rest, with input saturation.

    Raises
    ------
    ConfigError : the simulator does not support the instrument, or the motion diverges.
    """
    v = np.ascontiguousarray(drive_v, dtype=np.float64)
    respond = partial(read_out, values) if is_apart(values) else integrate
    y = respond(v, 1.0 / instrument.sample_rate_hz, steps, physics(values, instrument))
    if not np.all(np.isfinite(y)):
        raise ConfigError("the motion diverges", next_step="hide a weaker effect")
    return clipped(y, values)


def clipped(y: FloatArray, values: Mapping[str, float]) -> FloatArray:
    """``y`` (...) [V] limited to +- one level, the input stage of the converter; unchanged without adc_saturation."""
    inverse = float(values.get("adc_saturation.1/level", 0.0))
    return y if inverse == 0.0 else np.clip(y, -1.0 / inverse, 1.0 / inverse)


def hum(values: Mapping[str, float], samples: int, sample_rate_hz: float, random: np.random.Generator) -> FloatArray:
    """sum_h a_h cos(2 pi h f t + phase), (samples, 2) [V], with random phases in every channel and record.

    The values are "mains_hum.f" [Hz] and "mains_hum.a1", "mains_hum.a2", .. [V]; without them there is no hum.
    """
    volts = np.zeros((samples, 2))
    t = np.arange(samples) / sample_rate_hz
    for h in range(1, HARMONICS + 1):
        amplitude = float(values.get(f"mains_hum.a{h}", 0.0))
        for k in range(2):
            phase = random.uniform(0.0, 2.0 * math.pi)
            if amplitude != 0.0:
                volts[:, k] += amplitude * np.cos(2.0 * math.pi * h * values["mains_hum.f"] * t + phase)
    return volts
