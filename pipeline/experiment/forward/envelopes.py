"""Free decay of one mode by its slow equations: first harmonic of the motion, with its mean and its harmonics in step with it.

    z = (q, q') = Re sum_h Z_h e^{i h theta},     Z_1 = a r_m + sum_{p != m} c_p r_p,     theta' = W
    a' + i W a = lambda_m a + b_m F_1             the slow flow: a'/a = R(a, t), W(a, t)
    c_p = b_p F_1 / (i W + R - lambda_p)          other poles follow; likewise Z_h at h = 0, 2, 3

lambda_p, r_p: poles and right eigenvectors of the linear state; b_p: the velocity half of the left ones; F_h: harmonics of the
nonlinear force along the motion (alternating frequency and time).  For a linear device the flow is exact; its error is of second
order in the nonlinear force over the stiffness, times the damping ratio.
Source: averaging of Krylov and Bogoliubov to second order (Nayfeh and Mook, Nonlinear Oscillations, 1979, section 2.3).

R and W are tabulated over ln a, and over t where forces depend on time; ln a is integrated between the rows by Runge-Kutta.

Shapes: M points, G amplitudes, K times, T times of a period, n coordinates, S senses, N rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ...arrays import ComplexArray, FloatArray
from ...device.force_law import Points, force_along
from ...device.mechanics import state_matrix
from ...errors import ConfigError
from .system import System

#: Harmonics, times of a period, and iterations of the harmonics; as in ``harmonic_terms``.
_HARMONICS, _TIMES, _ITERATIONS = 3, 32, 6
_THETA = 2.0 * np.pi * np.arange(_TIMES) / _TIMES
#: Amplitudes of a table for each factor e, times of one where forces depend on time, and largest change of ln a in one step.
_PER_E, _NODES, _STEP = 6, 9, 0.05
#: ln of an amplitude over the largest of the table from which on a motion grows without bound.
_GROWN = 3.0
#: Most steps between two rows.
_MOST_STEPS = 400


@dataclass(frozen=True, eq=False)
class SlowFlow:
    """The flow of one mode on a table.

    Parameters
    ----------
    log_a : (G,) rising, equal steps; a is the position of the mode [V s].
    time_s : (K,) rising, equal steps [s].
    rate, omega : (K, G) R [1/s] and W [rad/s].
    tone : (K, G, S) amplitude in the pick-off behind the read-out over a [1/s].
    """

    log_a: FloatArray
    time_s: FloatArray
    rate: FloatArray
    omega: FloatArray
    tone: FloatArray


def mode_near(system: System, about_hz: float) -> int:
    """Index of the pole [of numpy's eig of the state matrix] nearest to a frequency; raises ConfigError where none oscillates."""
    poles = np.linalg.eigvals(state_matrix(system.mechanics))[0]
    upper = np.flatnonzero(poles.imag > 0.0)
    if not upper.size:
        raise ConfigError("no mode oscillates", next_step="check frequencies and damping")
    return int(upper[np.argmin(np.abs(poles[upper].imag - 2.0 * np.pi * about_hz))])


def flow_at(system: System, mode: int, a: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """R (M,) [1/s], W (M,) [rad/s] and the tone over a (M, S) of the amplitudes a (M,) [V s] at the times t (M,) [s]."""
    if system.memories:
        raise ConfigError(
            "an effect with a memory is not computed for amplitudes of free decays",
            value=[effect.name for effect, _ in system.forces if effect.memories],
            next_step='remove it from the model, or use samples of the decay (kind = "decay")',
        )
    mechanics = system.mechanics
    n, points = mechanics.stiffness.shape[1], a.size
    poles, right = np.linalg.eig(state_matrix(mechanics)[0])
    top = right[:n, mode]
    right[:, mode] = right[:, mode] / top[int(np.argmax(np.abs(top)))]
    left = np.linalg.inv(right)[:, n:]
    others = np.arange(2 * n) != mode
    flow: ComplexArray = np.full(points, poles[mode])
    z = np.zeros((_HARMONICS + 1, points, 2 * n), dtype=np.complex128)
    z[1] = a[:, None] * right[:, mode]
    turns = np.exp(1.0j * np.arange(_HARMONICS + 1)[:, None] * _THETA)
    drives = np.zeros((mechanics.drive.shape[2], points * _TIMES))
    for _ in range(_ITERATIONS if system.forces else 0):
        motion = np.einsum("hmk,ht->kmt", z, turns).real.reshape(2 * n, -1)
        at = Points(np.repeat(t, _TIMES), np.ascontiguousarray(motion[:n]), np.ascontiguousarray(motion[n:]), drives)
        force = np.zeros((n, points * _TIMES))
        for effect, p in system.forces:
            assert effect.force is not None
            force += force_along(effect.force, at, p, system.laws)
        harmonics = np.einsum("imt,ht->hmi", force.reshape(n, points, _TIMES), 2.0 / _TIMES * turns.conj())
        harmonics[0] *= 0.5
        flow = poles[mode] + harmonics[1] @ left[mode] / a
        for h in range(_HARMONICS + 1):
            kept = others if h == 1 else np.ones(2 * n, dtype=bool)
            speed = h * (flow.real + 1.0j * flow.imag)[:, None] - poles[kept]
            z[h] = (harmonics[h] @ left[kept].T / speed) @ right[:, kept].T
        z[1] += a[:, None] * right[:, mode]
    if not np.all(np.isfinite(z)):
        raise ConfigError(
            "the motion has no steady envelope", next_step="check the size and sign of the nonlinear effects"
        )
    return flow.real, flow.imag, _tones(system, z, flow, t, turns) / a[:, None]


def _tones(system: System, z: ComplexArray, flow: ComplexArray, t: FloatArray, turns: ComplexArray) -> FloatArray:
    """Amplitude (M, S) [V] in the pick-offs, behind the read-out."""
    n = z.shape[2] // 2
    reads = system.mechanics.reads[0]
    tone = z[1] @ reads.T
    if system.senses:
        s = np.einsum("hmk,ht->mtk", z, turns).real
        q, v, volts = s[..., :n], s[..., n:], s @ reads.T
        shape = (-1, volts.shape[2])
        volts, at = volts.reshape(shape), np.repeat(t, _TIMES)
        motion, speed = ((one @ system.sense_motion.T).reshape(shape) for one in (q, v))
        for effect, p in system.senses:
            assert effect.sense is not None
            volts = effect.sense(motion, speed, volts, at, p, system.context)
        tone = np.einsum("mts,t->ms", volts.reshape(-1, _TIMES, shape[1]), 2.0 / _TIMES * turns[1].conj())
    return np.abs((system.readout.response(flow) @ tone[:, :, None])[:, :, 0])


def slow_flow(system: System, mode: int, lowest: float, highest: float, seconds: float) -> SlowFlow:
    """The table from the amplitude ``lowest`` to ``highest`` [V s] over a record of ``seconds``."""
    count = max(int(_PER_E * np.log(highest / lowest)), 8)
    log_a = np.linspace(np.log(lowest), np.log(highest), count)
    ends = np.exp(log_a[[0, -1, 0, -1]])
    times = np.array([0.0, 0.0, seconds, seconds])
    timed = bool(system.forces or system.senses) and not all(
        np.allclose(each[:2], each[2:], rtol=1e-12) for each in flow_at(system, mode, ends, times)
    )
    nodes = np.linspace(0.0, seconds, _NODES) if timed else np.zeros(1)
    a, t = np.tile(np.exp(log_a), nodes.size), np.repeat(nodes, count)
    rate, omega, tone = flow_at(system, mode, a, t)
    return SlowFlow(
        log_a, nodes, rate.reshape(-1, count), omega.reshape(-1, count), tone.reshape(nodes.size, count, -1)
    )


def decay(flow: SlowFlow, log_a: float, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Tone amplitude (N, S) [V], phase (N,) [rad] from the first row, R (N,) and W (N,) at the rows (N,) [s], from ln a there.

    Raises
    ------
    ConfigError : the motion grows.
    """
    x, phase = np.empty(time_s.size), np.empty(time_s.size)
    _integrated(
        flow.log_a[0], flow.log_a[1] - flow.log_a[0], flow.time_s, flow.rate, flow.omega, log_a, time_s, x, phase
    )
    if not np.max(x) < flow.log_a[-1] + _GROWN:
        raise ConfigError("the motion grows", allowed="an amplitude that falls", next_step="check the damping")
    t = time_s - time_s[0]
    rate, omega = (_table(flow, each[:, :, None], x, t)[:, 0] for each in (flow.rate, flow.omega))
    tone = _table(flow, flow.tone, x, t) * np.exp(x)[:, None]
    return tone, phase, rate, omega


def _table(flow: SlowFlow, table: FloatArray, x: FloatArray, t: FloatArray) -> FloatArray:
    """Values (N, C) of a table (K, G, C) at ln a and t (N,): cubic in ln a, linear in t."""
    return np.stack(
        [
            _values(flow.log_a[0], flow.log_a[1] - flow.log_a[0], flow.time_s, np.ascontiguousarray(own), x, t)
            for own in np.moveaxis(table, 2, 0)
        ],
        axis=1,
    )


@njit(cache=True, error_model="numpy")
def _row(first: float, step: float, row: FloatArray, x: float) -> float:
    """Cubic through four neighbours; held beyond the ends."""
    at = min(max((x - first) / step, 0.0), row.size - 1.0)
    k = min(max(int(at), 1), row.size - 3)
    s = at - k
    a, b, c, d = row[k - 1], row[k], row[k + 1], row[k + 2]
    return (
        -s * (s - 1.0) * (s - 2.0) / 6.0 * a
        + (s + 1.0) * (s - 1.0) * (s - 2.0) / 2.0 * b
        - (s + 1.0) * s * (s - 2.0) / 2.0 * c
        + (s + 1.0) * s * (s - 1.0) / 6.0 * d
    )


@njit(cache=True, error_model="numpy")
def _value(first: float, step: float, nodes: FloatArray, table: FloatArray, x: float, t: float) -> float:
    if nodes.size == 1:
        return _row(first, step, table[0], x)
    at = min(max(t / (nodes[1] - nodes[0]), 0.0), nodes.size - 1.0)
    k = min(int(at), nodes.size - 2)
    return (k + 1 - at) * _row(first, step, table[k], x) + (at - k) * _row(first, step, table[k + 1], x)


@njit(cache=True, error_model="numpy")
def _values(
    first: float, step: float, nodes: FloatArray, table: FloatArray, x: FloatArray, t: FloatArray
) -> FloatArray:
    out = np.empty(x.size)
    for i in range(x.size):
        out[i] = _value(first, step, nodes, table, x[i], t[i])
    return out


@njit(cache=True, error_model="numpy")
def _integrated(
    first: float,
    step: float,
    nodes: FloatArray,
    rate: FloatArray,
    omega: FloatArray,
    start: float,
    time_s: FloatArray,
    x: FloatArray,
    phase: FloatArray,
) -> None:
    """ln a and the phase at the rows, into ``x`` and ``phase`` (N,)."""
    at, turned, t = start, 0.0, 0.0
    x[0], phase[0] = at, 0.0
    for i in range(1, time_s.size):
        gap = time_s[i] - time_s[i - 1]
        steps = int(min(abs(_value(first, step, nodes, rate, at, t)) * gap / _STEP, _MOST_STEPS)) + 1
        h = gap / steps
        for _ in range(steps):
            k1 = _value(first, step, nodes, rate, at, t)
            k2 = _value(first, step, nodes, rate, at + 0.5 * h * k1, t + 0.5 * h)
            k3 = _value(first, step, nodes, rate, at + 0.5 * h * k2, t + 0.5 * h)
            k4 = _value(first, step, nodes, rate, at + h * k3, t + h)
            middle = at + h * (5.0 * k1 + 4.0 * k2 + 4.0 * k3 - k4) / 24.0
            after = at + h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
            turned += (
                h
                / 6.0
                * (
                    _value(first, step, nodes, omega, at, t)
                    + 4.0 * _value(first, step, nodes, omega, middle, t + 0.5 * h)
                    + _value(first, step, nodes, omega, after, t + h)
                )
            )
            at, t = after, t + h
        x[i], phase[i] = at, turned
