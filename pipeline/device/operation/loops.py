"""Drive loop, rebalance loop and demodulators, sample by sample.

The loops work in the frame of a numerically controlled oscillator with phase Phi, Phi' = omega:

    v = Re(V exp(j Phi)),      V[n+1] = V[n] + 2 g T (v[n] - Re(V[n] exp(j Phi[n]))) exp(-j Phi[n])        (demodulator)

The demodulator has feedback, bandwidth g, and no ripple at twice the frequency once it has settled.  V_y and V_x are the
envelopes of psi_y' and psi_x':

    drive       tau_y = Re(T_y exp(j Phi)),   Re T_y = PI(A - Re V_y);   phase-locked: omega = omega_c + PI(Im V_y) / A,
                Im T_y = 0, so torque and velocity are in phase;   forced: omega = omega_c, Im T_y = PI(-Im V_y)
    rebalance   tau_x = -Re(PI(V_x) exp(j Phi)) - G psi_x',   G the gain of the direct (high-gain) loop

For the envelope the plant is an integrator with gain 1/2, so PI(e) = 2 b (e + b/4 int e dt) gives a critically damped loop of
bandwidth b; the phase loop is b (e + b/4 int e dt).
Shapes: B devices, N samples, M envelope points, W last samples.  Units: velocities V, torques V/s, bandwidths rad/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray
from ...errors import ConfigError


@dataclass(frozen=True, eq=False)
class PhaseLocked:
    """The drive locks to the frequency at which torque and velocity are in phase.

    start_hz : initial frequency of the oscillator (B,) [Hz], accurate to about 10 Hz.
    """

    start_hz: FloatArray


@dataclass(frozen=True, eq=False)
class Forced:
    """The drive runs at a prescribed frequency, with the torque that this needs: frequency_hz (B,) [Hz]."""

    frequency_hz: FloatArray


Drive = PhaseLocked | Forced


@dataclass(frozen=True)
class Loops:
    """Amplitude and bandwidths of the loops.

    amplitude_v : A, amplitude of psi_y' [V].
    drive_hz : closed-loop bandwidth of amplitude and phase [Hz].
    rebalance_hz : closed-loop bandwidth of the demodulated rebalance loop [Hz]; 0 opens the loop.
    direct_per_s : G, gain of the direct rebalance loop [1/s].
    demodulator_hz : bandwidth of the demodulators inside the loops [Hz].
    output_hz : bandwidth of the demodulator of the rebalance torque [Hz].

    Raises
    ------
    ConfigError : a value is out of range, or a loop is faster than a quarter of ``demodulator_hz``.
    """

    amplitude_v: float = 1.0
    drive_hz: float = 10.0
    rebalance_hz: float = 10.0
    direct_per_s: float = 0.0
    demodulator_hz: float = 100.0
    output_hz: float = 50.0

    def __post_init__(self) -> None:
        for name in ("amplitude_v", "drive_hz", "demodulator_hz", "output_hz"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(f"{name} of the loops must be positive", value=getattr(self, name), allowed="> 0")
        for name in ("rebalance_hz", "direct_per_s"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(
                    f"{name} of the loops must not be negative", value=getattr(self, name), allowed=">= 0"
                )
        if 4.0 * max(self.drive_hz, self.rebalance_hz) > self.demodulator_hz:
            raise ConfigError(
                "the loops are too fast for their demodulators",
                value=max(self.drive_hz, self.rebalance_hz),
                allowed=f"bandwidths up to a quarter of demodulator_hz, {self.demodulator_hz / 4.0:g} Hz",
                next_step="lower drive_hz and rebalance_hz or raise demodulator_hz",
            )


@njit(cache=True)
def close_loops(
    step: FloatArray,
    coriolis: FloatArray,
    step_s: float,
    carrier: float,
    locked: bool,
    amplitude: float,
    drive: float,
    rebalance: float,
    direct: float,
    demodulator: float,
    output: float,
    every: int,
    envelope: ComplexArray,
    omega_out: FloatArray,
    wave: FloatArray,
) -> None:
    """Run one device from rest; writes envelope (M, 4), omega_out (M,) [rad/s] and wave (W, 7).

    The columns of ``envelope`` are V_y, V_x [V], T_y and the demodulated tau_x [V/s]; those of ``wave`` are psi_x, psi_y [V s],
    psi_x', psi_y' [V], tau_x, tau_y [V/s] and Phi [rad] at the samples.  ``step`` (6, 4, 8) is from :func:`propagators`, with
    ``direct`` included in the damping; ``coriolis`` (N,) is 2 kappa Omega [rad/s]; other frequencies are in rad/s.
    """
    samples = coriolis.size
    state = np.zeros(8)
    after = np.zeros(4)
    v_x = v_y = torque_x = 0.0 + 0.0j
    sum_x = sum_y = 0.0 + 0.0j
    sum_phase = 0.0
    phase, omega = 0.0, carrier
    first_wave = samples - wave.shape[0]
    for n in range(samples):
        rotation = complex(math.cos(phase), math.sin(phase))
        back = np.conj(rotation)
        v_x += 2.0 * demodulator * step_s * (state[2] - (v_x * rotation).real) * back
        v_y += 2.0 * demodulator * step_s * (state[3] - (v_y * rotation).real) * back

        error = amplitude - v_y
        sum_y += 0.25 * drive * step_s * error
        t_y = 2.0 * drive * (error + sum_y)
        if locked:
            sum_phase += 0.25 * drive * step_s * v_y.imag / amplitude
            omega = carrier + drive * (v_y.imag / amplitude + sum_phase)
            t_y = complex(t_y.real, 0.0)
        sum_x += 0.25 * rebalance * step_s * v_x
        t_x = -2.0 * rebalance * (v_x + sum_x)

        w_x, w_y = t_x * rotation, t_y * rotation
        tau_x = w_x.real - direct * state[2]
        torque_x += 2.0 * output * step_s * (tau_x - (torque_x * rotation).real) * back
        if n % every == 0:
            m = n // every
            envelope[m, 0], envelope[m, 1], envelope[m, 2], envelope[m, 3] = v_y, v_x, t_y, torque_x
            omega_out[m] = omega
        if n >= first_wave:
            row = n - first_wave
            for i in range(4):
                wave[row, i] = state[i]
            wave[row, 4], wave[row, 5], wave[row, 6] = tau_x, w_y.real, phase

        state[4], state[5], state[6], state[7] = w_x.real, w_y.real, w_x.imag, w_y.imag
        a, b = coriolis[n], omega - carrier
        for i in range(4):
            total = 0.0
            for j in range(8):
                gain = step[0, i, j] + a * (step[1, i, j] + a * step[3, i, j] + b * step[4, i, j])
                total += (gain + b * (step[2, i, j] + b * step[5, i, j])) * state[j]
            after[i] = total
        for i in range(4):
            state[i] = after[i]
        phase = (phase + omega * step_s) % (2.0 * math.pi)
