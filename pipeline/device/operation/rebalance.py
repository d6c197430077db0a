"""Time simulation of a force-rebalanced gyro (the paper, section 2.2 and figure 3).

    psi'' + 2 kappa Omega [[0, -1], [1, 0]] psi' + C psi' + K psi = tau      (eq. 1, mass-normalised)

The drive loop holds psi_y' = A cos Phi, and the rebalance loop holds psi_x at zero.  Then row x of (1) is the rebalance torque
and row y the drive torque, without approximation:

    tau_x = K_xy psi_y + (C_xy - 2 kappa Omega) psi_y',    K_xy = 1/2 (w1^2 - w2^2) sin 2theta,
                                                           C_xy = 1/2 (c11 - c22) sin 2theta + c12 cos 2theta      (4)
    tau_y = psi_y'' + C_yy psi_y' + K_yy psi_y,            K_yy = w1^2 sin^2 theta + w2^2 cos^2 theta,
                                                           C_yy = c11 sin^2 + c22 cos^2 + c12 sin 2theta           (3)

In envelopes relative to that of psi_y' (in phase + j quadrature), demodulated with cos(Phi + phi):

    tau_x / psi_y' = C_xy - 2 kappa Omega - j K_xy / omega0
    Omega_indicated = -Re[exp(-j phi) tau_x / psi_y'] / (2 kappa cos phi)
                    = Omega + K_xy tan(phi) / (2 kappa omega0) - C_xy / (2 kappa)

A phase-locked drive runs where its torque is in phase with the velocity: omega0^2 = K_yy, between the two modes.  The paper
takes omega0 = w1 or w2; the relative difference, also of the quadrature rate, is below the relative split.

The electrodes apply ideal torques about x and y: gains, up-down mode and noise are not simulated.
Shapes: B devices, N samples, M envelope points, W last samples.  Units: psi in V s, psi' in V, torques in V/s, kappa 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...errors import ConfigError
from ..gyro import TAU, gyro_mechanics
from .loops import Drive, Loops, PhaseLocked, close_loops
from .propagator import propagators


@dataclass(frozen=True, eq=False)
class Waveforms:
    """The last W samples of psi (B, W, 2) [V s], psi' (B, W, 2) [V], tau (B, W, 2) [V/s] and Phi (B, W) [rad]."""

    position: FloatArray
    velocity: FloatArray
    torque: FloatArray
    phase: FloatArray


@dataclass(frozen=True, eq=False)
class Operation:
    """Result of a run of the closed loops.

    time_s : time of the envelopes (M,) [s].
    drive_velocity, sense_velocity : envelopes of psi_y' and psi_x' (B, M) [V].
    drive_torque, rebalance_torque : envelopes of tau_y and tau_x (B, M) [V/s].
    frequency_hz : omega0 / 2 pi (B, M) [Hz].
    rate_dps : Omega (B, M) [deg/s], the input.
    waveforms : the last samples.
    """

    time_s: FloatArray
    drive_velocity: ComplexArray
    sense_velocity: ComplexArray
    drive_torque: ComplexArray
    rebalance_torque: ComplexArray
    frequency_hz: FloatArray
    rate_dps: FloatArray
    waveforms: Waveforms


@dataclass(frozen=True, eq=False)
class Rebalance:
    """Settled operation; each field is (B,).

    amplitude_v : |psi_y'| [V].
    frequency_hz : omega0 / 2 pi [Hz].
    inphase_per_s, quadrature_per_s : rebalance torque in phase with psi_y' and 90 deg ahead of it, over psi_y' [1/s]:
        C_xy - 2 kappa Omega and -K_xy / omega0.
    damping_per_s : drive torque in phase with psi_y', over psi_y': C_yy [1/s].
    """

    amplitude_v: FloatArray
    frequency_hz: FloatArray
    inphase_per_s: FloatArray
    quadrature_per_s: FloatArray
    damping_per_s: FloatArray


def self_oscillation_hz(physical: FloatArray) -> FloatArray:
    """sqrt(w1^2 sin^2 theta + w2^2 cos^2 theta) / 2 pi (...) [Hz], the resonance of (3), from physical parameters (..., 12)."""
    f1, f2, theta = physical[..., 0], physical[..., 1], np.deg2rad(physical[..., 6])
    return np.asarray(np.hypot(f1 * np.sin(theta), f2 * np.cos(theta)))


def operate(
    physical: FloatArray,
    angular_gain: float | FloatArray,
    rate_dps: float | FloatArray = 0.0,
    drive: Drive | None = None,
    loops: Loops | None = None,
    duration_s: float = 1.5,
    sample_rate_hz: float = 20_000.0,
    envelope_hz: float = 1_000.0,
    waveform_s: float = 0.02,
) -> Operation:
    """Simulate the closed loops around devices that start at rest.

    Parameters
    ----------
    physical : (B, 12), the columns of ``pipeline.device.gyro.PHYSICAL``; only frequencies, damping, theta and c12 are used.
    angular_gain : kappa = I_p / I_0p, (B,) or one number for all devices.
    rate_dps : Omega [deg/s], constant (one number or (B, 1)) or given at every sample ((N,) or (B, N)).
    drive : by default phase-locked, starting at the mean of f1 and f2.
    loops : amplitude and bandwidths.
    duration_s, sample_rate_hz : N = duration f_s steps of the controller.
    envelope_hz : rate of the envelopes.
    waveform_s : duration at the end of the run that is kept sample by sample [s].

    Raises
    ------
    ConfigError : fewer than 12 samples per cycle, a rate of the wrong shape, kappa not positive, or unstable loops (the
        velocity exceeds 1e6 amplitudes or is not finite).
    """
    loops = Loops() if loops is None else loops
    drive = PhaseLocked((physical[:, 0] + physical[:, 1]) / 2.0) if drive is None else drive
    batch = physical.shape[0]
    start = drive.start_hz if isinstance(drive, PhaseLocked) else drive.frequency_hz
    carrier = TAU * np.broadcast_to(np.asarray(start, dtype=np.float64), (batch,))
    kappa = np.broadcast_to(np.asarray(angular_gain, dtype=np.float64), (batch,))
    if not np.all(kappa > 0.0):
        raise ConfigError("angular gain must be positive", value=angular_gain, allowed="I_p / I_0p in (0, 1]")
    if not np.all((carrier > 0.0) & (12.0 * carrier < TAU * sample_rate_hz)):
        raise ConfigError(
            "too few controller samples per cycle",
            value=float(sample_rate_hz),
            allowed=f"at least 12 per cycle, {12.0 * float(np.max(carrier)) / TAU:.0f} Hz",
            next_step="raise sample_rate_hz",
        )
    step_s, samples = 1.0 / sample_rate_hz, round(duration_s * sample_rate_hz)
    rates = np.asarray(rate_dps, dtype=np.float64)
    along, across = rates.shape[-1:] or (1,), rates.shape[:-1] or (1,)
    if rates.ndim > 2 or along[0] not in (1, samples) or across[0] not in (1, batch):
        raise ConfigError(
            "the rate does not fit the run",
            value=rates.shape,
            allowed=f"one number, ({batch}, 1), ({samples},) or ({batch}, {samples})",
            next_step="hold the rate constant or give it at every sample",
        )
    rates = np.broadcast_to(rates, (batch, samples))
    every = max(1, round(sample_rate_hz / envelope_hz))
    kept = min(samples, max(1, round(waveform_s * sample_rate_hz)))

    mechanics = gyro_mechanics(physical)
    damping = mechanics.damping[:, :2, :2].copy()
    damping[:, 0, 0] += loops.direct_per_s
    steps = propagators(damping, mechanics.stiffness[:, :2, :2], carrier, step_s)
    envelope = np.zeros((batch, -(-samples // every), 4), dtype=np.complex128)
    omega = np.zeros(envelope.shape[:2])
    wave = np.zeros((batch, kept, 7))
    for i in range(batch):
        close_loops(
            steps[i],
            2.0 * kappa[i] * np.deg2rad(rates[i]),
            step_s,
            float(carrier[i]),
            isinstance(drive, PhaseLocked),
            loops.amplitude_v,
            TAU * loops.drive_hz,
            TAU * loops.rebalance_hz,
            loops.direct_per_s,
            TAU * loops.demodulator_hz,
            TAU * loops.output_hz,
            every,
            envelope[i],
            omega[i],
            wave[i],
        )
    size = np.abs(envelope[:, :, 0])
    if not np.all(size < 1e6 * loops.amplitude_v):
        raise ConfigError(
            "the loops are unstable",
            value=int(np.argmax(~np.all(size < 1e6 * loops.amplitude_v, axis=1))),
            allowed="a drive that stays near its amplitude",
            next_step="lower the bandwidths or direct_per_s, or raise sample_rate_hz",
        )
    waveforms = Waveforms(wave[:, :, :2], wave[:, :, 2:4], wave[:, :, 4:6], wave[:, :, 6])
    return Operation(
        np.arange(envelope.shape[1], dtype=np.float64) * (every * step_s),
        envelope[:, :, 0],
        envelope[:, :, 1],
        envelope[:, :, 2],
        envelope[:, :, 3],
        omega / TAU,
        rates[:, ::every],
        waveforms,
    )


def _over(torque: ComplexArray, velocity: ComplexArray) -> ComplexArray:
    """torque / velocity, nan where the velocity is zero."""
    moving = velocity != 0.0
    return np.asarray(np.where(moving, torque / np.where(moving, velocity, 1.0), complex(np.nan, np.nan)))


def settled(operation: Operation, last_s: float = 0.2) -> Rebalance:
    """Mean over the last ``last_s`` [s]; fields (B,).

    Raises
    ------
    ConfigError : the loops have not settled, or the rate is not constant: the amplitude changes by more than 1e-3 of itself, or
        the ratio of the torques by more than 1e-3 of its largest value (at least 1/s).
    """
    last = operation.time_s >= operation.time_s[-1] - last_s
    velocity = operation.drive_velocity[:, last]
    amplitude = np.abs(velocity)
    ratio = _over(operation.rebalance_torque[:, last], velocity)
    driven = _over(operation.drive_torque[:, last], velocity)
    change = np.maximum(
        np.ptp(amplitude, axis=1) / amplitude.mean(axis=1),
        np.abs(ratio - ratio[:, -1:]).max(axis=1) / np.maximum(np.abs(ratio).max(axis=1), 1.0),
    )
    if not np.all(change < 1e-3):
        raise ConfigError(
            "the loops have not settled",
            value=float(np.max(change)),
            allowed="relative changes below 1e-3 at the end of the run",
            next_step="raise duration_s, or hold the rate constant",
        )
    return Rebalance(
        amplitude.mean(axis=1),
        operation.frequency_hz[:, last].mean(axis=1),
        ratio.real.mean(axis=1),
        ratio.imag.mean(axis=1),
        driven.real.mean(axis=1),
    )


def indicated_rate_dps(
    inphase_per_s: FloatArray,
    quadrature_per_s: FloatArray,
    angular_gain: float | FloatArray,
    phase_error_deg: float | FloatArray,
) -> FloatArray:
    """Omega_indicated = -[inphase + quadrature tan(phi)] / (2 kappa) [deg/s]; arguments in 1/s, 1 and deg; shapes broadcast."""
    leaked = quadrature_per_s * np.tan(np.deg2rad(phase_error_deg))
    return np.asarray(np.rad2deg(-(inphase_per_s + leaked) / (2.0 * np.asarray(angular_gain))))


def measured_biases_dps(
    at_rest: Rebalance, angular_gain: float | FloatArray, phase_error_deg: float | FloatArray
) -> dict[str, FloatArray]:
    """The biases of ``operation.bias``, each (B,) [deg/s] by the same names, from a run at Omega = 0; phi [deg]."""
    none = np.zeros_like(at_rest.inphase_per_s)
    # tan(45 deg) = 1, so the whole quadrature torque is converted to a rate.
    quadrature = indicated_rate_dps(none, at_rest.quadrature_per_s, angular_gain, 45.0)
    leaked = indicated_rate_dps(none, at_rest.quadrature_per_s, angular_gain, phase_error_deg)
    inphase = indicated_rate_dps(at_rest.inphase_per_s, none, angular_gain, 0.0)
    return {
        "quadrature_rate_dps": quadrature,
        "quadrature_bias_dps": leaked,
        "inphase_bias_dps": inphase,
        "rate_bias_dps": leaked + inphase,
    }


def output_rate_dps(
    operation: Operation, angular_gain: float | FloatArray, phase_error_deg: float | FloatArray = 0.0
) -> FloatArray:
    """Indicated rate (B, M) [deg/s] over time, nan before the device moves; kappa and phi [deg] are (B,) or one number."""
    ratio = _over(operation.rebalance_torque, operation.drive_velocity)
    kappa, phi = (np.asarray(one, dtype=np.float64)[..., None] for one in (angular_gain, phase_error_deg))
    return indicated_rate_dps(ratio.real, ratio.imag, kappa, phi)
