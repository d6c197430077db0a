"""Loops of harmonic balance: the steady motion at each row of a sweep, followed in the order of the rows.

    q(t) = a_0 + sum_h a_h cos(h w t) + b_h sin(h w t),   h = 1 .. H         unknowns x (n (2 H + 1),), coordinate by coordinate

    R = K a_h - h^2 w^2 a_h + h w C b_h - <f>_h^cos = 0,   likewise for sin and the mean,   f = F u + a(t, q, q', u)

Forces are evaluated at T times of a period and projected (alternating frequency and time, Cameron and Griffin 1989).  Their
derivatives are differences of the force laws at each time.

A row starts from the motion of the row before, in steps that are halved where Newton's method fails, changes the motion much, or
ends on an unstable solution (det J < 0, a saddle).  Where no step is left the solution ends in a fold, and the motion jumps: the
slow flow

    D dx/dt = -R,   D: (a_h, b_h)' -> (C a_h' + 2 h w b_h', C b_h' - 2 h w a_h'),   C a_0' for the mean

is integrated from there by linearly implicit steps that grow, to the solution that a slow sweep reaches.

Shapes: N rows, n coordinates, D drives, m = n (2 H + 1).  Units: volts, seconds, rad/s.

Long because the compiler needs the functions that call each other with one list of arguments in one place.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ...arrays import FloatArray, IntArray
from ...device.force_law import Laws, push

#: Newton iterations of a step; relative change at which they end; largest relative change of the motion in one step.
NEWTON, TOLERANCE, LARGEST_STEP = 12, 1e-11, 0.35
#: Halvings of a step before a jump; steps of the slow flow at its first length (in decay times), then growing.
HALVINGS, SLOW_STEPS, SLOW_LENGTH, GROWING_STEPS = 7, 60, 0.25, 60


@njit(cache=True, error_model="numpy")
def _solve(a: FloatArray, b: FloatArray) -> float:
    """Solve a x = b (m,) in place by elimination; the sign of det a, 0 where it is singular."""
    m = b.size
    sign = 1.0
    for i in range(m):
        top = i
        for r in range(i + 1, m):
            if abs(a[r, i]) > abs(a[top, i]):
                top = r
        if not abs(a[top, i]) > 0.0:
            return 0.0
        if top != i:
            sign = -sign
            for c in range(i, m):
                a[i, c], a[top, c] = a[top, c], a[i, c]
            b[i], b[top] = b[top], b[i]
        if a[i, i] < 0.0:
            sign = -sign
        for r in range(i + 1, m):
            factor = a[r, i] / a[i, i]
            if factor != 0.0:
                for c in range(i + 1, m):
                    a[r, c] -= factor * a[i, c]
                b[r] -= factor * b[i]
    for i in range(m - 1, -1, -1):
        total = b[i]
        for c in range(i + 1, m):
            total -= a[i, c] * b[c]
        b[i] = total / a[i, i]
    return sign


@njit(cache=True, error_model="numpy")
def _balance(
    forces: IntArray,
    p: FloatArray,
    ends: IntArray,
    laws: Laws,
    gyroscopic: FloatArray,
    shapes: FloatArray,
    t: float,
    w: float,
    u: FloatArray,
    x: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Residual (m,) and Jacobian (m, m) at x (m,).

    ``shapes`` (2 H + 1, T): 1, cos(theta), sin(theta), cos(2 theta), ..; u (T, D) force volts at these phases.
    """
    n = laws.stiffness.shape[0]
    terms, times = shapes.shape
    harmonics = terms // 2
    residual[:] = 0.0
    jacobian[:] = 0.0
    for i in range(n):
        for j in range(n):
            k, c = laws.stiffness[i, j], laws.damping[i, j] + gyroscopic[i, j]
            jacobian[i * terms, j * terms] += k
            for h in range(1, harmonics + 1):
                a, b = 2 * h - 1, 2 * h
                hw = h * w
                own = k - (hw * hw if i == j else 0.0)
                jacobian[i * terms + a, j * terms + a] += own
                jacobian[i * terms + a, j * terms + b] += hw * c
                jacobian[i * terms + b, j * terms + b] += own
                jacobian[i * terms + b, j * terms + a] -= hw * c
    for r in range(n * terms):
        total = 0.0
        for c in range(n * terms):
            total += jacobian[r, c] * x[c]
        residual[r] = total
    q, qd, out, moved = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    largest = 0.0
    for c in range(n * terms):
        largest = max(largest, abs(x[c]))
    step = 1e-6 * largest
    for s in range(times):
        for i in range(n):
            value, rate = x[i * terms], 0.0
            for h in range(1, harmonics + 1):
                a, b = x[i * terms + 2 * h - 1], x[i * terms + 2 * h]
                value += a * shapes[2 * h - 1, s] + b * shapes[2 * h, s]
                rate += h * w * (b * shapes[2 * h - 1, s] - a * shapes[2 * h, s])
            q[i], qd[i], out[i] = value, rate, 0.0
        for k in range(forces.size):
            push(forces[k], t, q, qd, u[s], p, ends[k], ends[k + 1], laws, out)
        for i in range(n):
            total = out[i]
            for d in range(u.shape[1]):
                total += laws.drive[i, d] * u[s, d]
            residual[i * terms] -= total / times
            for r in range(1, terms):
                residual[i * terms + r] -= 2.0 / times * total * shapes[r, s]
        if forces.size == 0 or step == 0.0:
            continue
        for j in range(n):
            for kind in range(2):
                size = step if kind == 0 else step * w
                at = q[j] if kind == 0 else qd[j]
                if kind == 0:
                    q[j] = at + size
                else:
                    qd[j] = at + size
                for i in range(n):
                    moved[i] = 0.0
                for k in range(forces.size):
                    push(forces[k], t, q, qd, u[s], p, ends[k], ends[k + 1], laws, moved)
                if kind == 0:
                    q[j] = at
                else:
                    qd[j] = at
                for i in range(n):
                    slope = (moved[i] - out[i]) / size
                    if slope == 0.0:
                        continue
                    for r in range(terms):
                        weight = (1.0 if r == 0 else 2.0) / times * slope * shapes[r, s]
                        if kind == 0:
                            for c in range(terms):
                                jacobian[i * terms + r, j * terms + c] -= weight * shapes[c, s]
                        else:
                            for h in range(1, harmonics + 1):
                                # q' holds -h w a sin + h w b cos.
                                jacobian[i * terms + r, j * terms + 2 * h - 1] += weight * h * w * shapes[2 * h, s]
                                jacobian[i * terms + r, j * terms + 2 * h] -= weight * h * w * shapes[2 * h - 1, s]


@njit(cache=True, error_model="numpy")
def _size(x: FloatArray) -> float:
    total = 0.0
    for i in range(x.size):
        total += x[i] * x[i]
    return np.sqrt(total)


@njit(cache=True, error_model="numpy")
def _newton(
    forces: IntArray,
    p: FloatArray,
    ends: IntArray,
    laws: Laws,
    gyroscopic: FloatArray,
    shapes: FloatArray,
    t: float,
    w: float,
    u: FloatArray,
    x: FloatArray,
    iterations: int,
    residual: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Newton's method from x (m,), in place: the sign of det J at the solution, 0 where it was not found."""
    last = np.inf
    for _ in range(iterations):
        _balance(forces, p, ends, laws, gyroscopic, shapes, t, w, u, x, residual, jacobian)
        sign = _solve(jacobian, residual)
        change, size = _size(residual), _size(x)
        if sign == 0.0 or not np.isfinite(change):
            return 0.0
        for i in range(x.size):
            x[i] -= residual[i]
        if change <= TOLERANCE * size or (change <= 1e-8 * size and change >= last) or size == change == 0.0:
            return sign
        last = change
    return 0.0


@njit(cache=True, error_model="numpy")
def _settle(
    forces: IntArray,
    p: FloatArray,
    ends: IntArray,
    laws: Laws,
    gyroscopic: FloatArray,
    shapes: FloatArray,
    t: float,
    w: float,
    u: FloatArray,
    x: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Slow flow from x (m,), in place, to a stable solution: 1 where it was reached, else 0."""
    n = laws.stiffness.shape[0]
    terms = shapes.shape[0]
    damping = np.inf
    for i in range(n):
        damping = min(damping, max(laws.damping[i, i], 1e-9 * w))
    step = SLOW_LENGTH * 2.0 / damping
    for k in range(SLOW_STEPS + GROWING_STEPS):
        if k >= SLOW_STEPS:
            step *= 1.6
        _balance(forces, p, ends, laws, gyroscopic, shapes, t, w, u, x, residual, jacobian)
        for i in range(n):
            for j in range(n):
                c = (laws.damping[i, j] + gyroscopic[i, j]) / step
                for r in range(terms):
                    jacobian[i * terms + r, j * terms + r] += c
            for h in range(1, terms // 2 + 1):
                a, b = i * terms + 2 * h - 1, i * terms + 2 * h
                jacobian[a, b] += 2.0 * h * w / step
                jacobian[b, a] -= 2.0 * h * w / step
        if _solve(jacobian, residual) == 0.0:
            return 0.0
        change, size = _size(residual), _size(x)
        if not np.isfinite(change):
            return 0.0
        for i in range(x.size):
            x[i] -= residual[i]
        if k > SLOW_STEPS // 2 and change <= 1e-5 * size:
            break
    sign = _newton(forces, p, ends, laws, gyroscopic, shapes, t, w, u, x, NEWTON, residual, jacobian)
    return 1.0 if sign > 0.0 else 0.0


def follow(
    forces: IntArray,
    p: FloatArray,
    ends: IntArray,
    laws: Laws,
    gyroscopic: FloatArray,
    shapes: FloatArray,
    times_s: FloatArray,
    omega: FloatArray,
    u: FloatArray,
    x: FloatArray,
) -> int:
    """The motion x (N, m) of every row, filled in the order of the rows; the number of rows without a stable solution.

    Parameters
    ----------
    forces, p, ends, laws, gyroscopic : the device.
    shapes : (2 H + 1, T) functions of the phase.
    times_s, omega, u : (N,) [s], (N,) [rad/s], (N, T, D) [V] of the rows.
    x : filled; a row without a solution has that of the linear device's last Newton step.
    """
    rows, size = x.shape
    residual, jacobian = np.empty(size), np.empty((size, size))
    now, trial = np.zeros(size), np.empty(size)
    drive = np.empty(u.shape[1:])
    missed = 0
    for i in range(rows):
        done = 0.0
        if i > 0:
            reached, step, halvings = 0.0, 1.0, 0
            while reached < 1.0 and halvings <= HALVINGS:
                share = min(reached + step, 1.0)
                w = omega[i - 1] + share * (omega[i] - omega[i - 1])
                t = times_s[i - 1] + share * (times_s[i] - times_s[i - 1])
                for a in range(u.shape[1]):
                    for d in range(u.shape[2]):
                        drive[a, d] = u[i - 1, a, d] + share * (u[i, a, d] - u[i - 1, a, d])
                trial[:] = now
                sign = _newton(
                    forces, p, ends, laws, gyroscopic, shapes, t, w, drive, trial, NEWTON, residual, jacobian
                )
                moved = _size(trial - now)
                if sign > 0.0 and moved <= LARGEST_STEP * max(_size(trial), _size(now)):
                    now[:] = trial
                    reached = share
                    if halvings > 0:
                        halvings -= 1
                        step *= 2.0
                else:
                    halvings += 1
                    step *= 0.5
            done = 1.0 if reached >= 1.0 else 0.0
        if done == 0.0:
            trial[:] = now
            done = _settle(
                forces, p, ends, laws, gyroscopic, shapes, times_s[i], omega[i], u[i], trial, residual, jacobian
            )
            if done > 0.0:
                now[:] = trial
            else:
                missed += 1
        x[i] = now
    return missed
