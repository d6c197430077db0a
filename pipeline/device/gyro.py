"""Plant "gyro": rocking about x and y, up-down z, two drive and two sense electrodes (the paper, eq. 1, 9, 10, 18).

    psi'' + C psi' + K psi = G_r M_D K_D v,      z'' + c33 z' + omega3^2 z = G_z (1, 1) K_D v
    S = K_S (M_S psi' + (1, 1)^T z'),   K_S = diag(1 - s, 1 + s),   K_D = diag(1 - d, 1 + d)
    M_S = [[-1, -1], [1, -1]],          M_D = [[-1, 1], [1, 1]]

Three equivalent sets of parameters:

physical   f1, f2, f3 [Hz], zeta1, zeta2, zeta3, theta [deg], c12 [1/s], G_r, G_z [1/s], s, d   (columns of ``PHYSICAL``)
cartesian  x = (omega0, eps_c, eps_s, c0, d_c, d_s [rad/s, 1/s], omega3, c33, ln G_r, ln G_z, s, d):
               K = omega0^2 I + omega0 E,  E = [[eps_c, eps_s], [eps_s, -eps_c]]
               C = c0 I + [[d_c, d_s], [d_s, -d_c]]           in the fixed x, y frame
           Smooth where the physical parameters are not: at zero split, and where theta crosses +-90 deg.
modes      poles p_k and residues R_k of H(s) = sum_k R_k / (s - p_k) + conj, from v to S.

theta is the angle of the principal axis u1 = (cos, sin) of the lower eigenvalue omega1^2 of K.  Shapes: B devices.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..arrays import ComplexArray, FloatArray, by_column, by_row
from .mechanics import Mechanics, Modes, modes_of

PHYSICAL: tuple[str, ...] = (
    "f1_hz",
    "f2_hz",
    "f3_hz",
    "zeta1",
    "zeta2",
    "zeta3",
    "theta_deg",
    "c12_per_s",
    "rocking_gain",
    "updown_gain",
    "sense_imbalance",
    "drive_imbalance",
)
CARTESIAN: tuple[str, ...] = (
    "omega0",
    "eps_c",
    "eps_s",
    "c0",
    "d_c",
    "d_s",
    "omega3",
    "c33",
    "ln_rocking_gain",
    "ln_updown_gain",
    "sense_imbalance",
    "drive_imbalance",
)
M_S: FloatArray = np.array([[-1.0, -1.0], [1.0, -1.0]])
M_D: FloatArray = np.array([[-1.0, 1.0], [1.0, 1.0]])
TAU = 2.0 * math.pi


def to_cartesian(physical: FloatArray) -> FloatArray:
    """Cartesian parameters (..., 12) from physical parameters (..., 12); units at the head of the module.

    The logarithms of gains that are not positive, which no device has, are nan.
    """
    f1, f2, f3, zeta1, zeta2, zeta3, theta_deg, c12, g_r, g_z, s, d = by_column(physical)
    omega1, omega2, omega3 = TAU * f1, TAU * f2, TAU * f3
    double = np.deg2rad(2.0 * theta_deg)
    omega0 = np.sqrt((omega1**2 + omega2**2) / 2.0)
    eps = (omega1 - omega2) * (omega1 + omega2) / (2.0 * omega0)
    c11, c22 = 2.0 * zeta1 * omega1, 2.0 * zeta2 * omega2
    delta = (c11 - c22) / 2.0
    with np.errstate(invalid="ignore", divide="ignore"):
        ln_r, ln_z = np.log(g_r), np.log(g_z)
    return np.stack(
        [
            omega0,
            eps * np.cos(double),
            eps * np.sin(double),
            (c11 + c22) / 2.0,
            delta * np.cos(double) - c12 * np.sin(double),
            delta * np.sin(double) + c12 * np.cos(double),
            omega3,
            2.0 * zeta3 * omega3,
            ln_r,
            ln_z,
            s,
            d,
        ],
        axis=-1,
    )


def to_physical(cartesian: FloatArray) -> FloatArray:
    """Physical parameters (..., 12) from cartesian parameters (..., 12), units at the head of the module; theta in (-90, 90].

    f1 and zeta1 are nan where no device has the parameters (eps > omega0).  The values of one parameter are neighbours in memory:
    all that follows takes parameter by parameter.
    """
    omega0, eps_c, eps_s, c0, d_c, d_s, omega3, c33, ln_r, ln_z, s, d = by_column(cartesian)
    eps = np.sqrt(eps_c * eps_c + eps_s * eps_s)
    # The lower axis has the eigenvalue -eps, so 2 theta is the angle of -(eps_c, eps_s).
    theta_deg = np.rad2deg(np.arctan2(-eps_s, -eps_c)) / 2.0
    theta_deg = np.where(theta_deg <= -90.0, theta_deg + 180.0, theta_deg)
    omega1 = np.sqrt(omega0**2 - omega0 * eps)
    omega2 = np.sqrt(omega0**2 + omega0 * eps)
    # At eps = 0 theta is 0 or 90 deg, by the sign of the zero.
    equal = eps == 0.0
    size = np.where(equal, 1.0, eps)
    cos, sin = np.where(equal, np.copysign(1.0, -eps_c), -eps_c / size), -eps_s / size
    delta = d_c * cos + d_s * sin
    c12 = d_s * cos - d_c * sin
    physical = np.stack(
        [
            omega1 / TAU,
            omega2 / TAU,
            omega3 / TAU,
            (c0 + delta) / (2.0 * omega1),
            (c0 - delta) / (2.0 * omega2),
            c33 / (2.0 * omega3),
            theta_deg,
            c12,
            np.exp(ln_r),
            np.exp(ln_z),
            s,
            d,
        ]
    )
    return by_row(physical)


def split_hz(cartesian: FloatArray) -> FloatArray:
    """(omega2 - omega1)/2pi = 2 omega0 eps / (omega1 + omega2) / 2pi (...) [Hz], free of cancellation; x (..., 12)."""
    omega0, eps_c, eps_s = by_column(cartesian[..., :3])
    eps = np.sqrt(eps_c * eps_c + eps_s * eps_s)
    omega1 = np.sqrt(omega0**2 - omega0 * eps)
    omega2 = np.sqrt(omega0**2 + omega0 * eps)
    return 2.0 * omega0 * eps / (omega1 + omega2) / TAU


def rocking_hz(x: FloatArray) -> tuple[float, float]:
    """f1 and f2 [Hz] of one device with cartesian parameters x (P,), P >= 12; f1 is nan where eps > omega0."""
    omega0, eps = float(x[0]), math.hypot(x[1], x[2])
    first, second = (omega0 * (omega0 + turn) for turn in (-eps, eps))
    return (math.sqrt(first) / TAU if first >= 0.0 else math.nan), math.sqrt(second) / TAU


def gyro_mechanics(physical: FloatArray) -> Mechanics:
    """Mechanics (n = 3) in (psi_x, psi_y, z) [V s] from physical parameters (B, 12): the paper, eq. (1), (9), (10), (18)."""
    return cartesian_mechanics(to_cartesian(physical))


def cartesian_mechanics(x: FloatArray) -> Mechanics:
    """Mechanics (n = 3) of cartesian parameters x (B, 12), as :func:`gyro_mechanics`."""
    batch = x.shape[0]
    omega0, eps_c, eps_s, c0, d_c, d_s, omega3, c33, ln_r, ln_z, s, d = x.T
    stiffness = np.zeros((batch, 3, 3))
    stiffness[:, 0, 0] = omega0 * (omega0 + eps_c)
    stiffness[:, 1, 1] = omega0 * (omega0 - eps_c)
    stiffness[:, 0, 1] = stiffness[:, 1, 0] = omega0 * eps_s
    stiffness[:, 2, 2] = omega3**2
    damping = np.zeros((batch, 3, 3))
    damping[:, 0, 0], damping[:, 1, 1] = c0 + d_c, c0 - d_c
    damping[:, 0, 1] = damping[:, 1, 0] = d_s
    damping[:, 2, 2] = c33
    k_s = np.stack([1.0 - s, 1.0 + s], axis=-1)
    k_d = np.stack([1.0 - d, 1.0 + d], axis=-1)
    drive = np.empty((batch, 3, 2))
    drive[:, :2, :] = np.exp(ln_r)[:, None, None] * M_D * k_d[:, None, :]
    drive[:, 2, :] = np.exp(ln_z)[:, None] * k_d
    sense = np.empty((batch, 2, 3))
    sense[:, :, :2] = k_s[:, :, None] * M_S
    sense[:, :, 2] = k_s
    zero = np.zeros((batch, 3, 3))
    return Mechanics(damping, zero, stiffness, drive, sense, np.zeros_like(sense))


def gyro_modes(physical: FloatArray) -> Modes:
    """Modes (B, 3) [rad/s] from physical parameters (B, 12), by the eigenvectors of the state matrix.

    Raises
    ------
    ConfigError : as in :func:`modes_of`.
    """
    return modes_of(gyro_mechanics(physical))


@njit(cache=True)
def _pole_near(
    start: complex, other: complex, kxx: float, kxy: float, kyy: float, cxx: float, cxy: float, cyy: float
) -> complex:
    """Root of det(s^2 I + s C + K) / (s - other) by Newton's method from ``start``; it never returns the root ``other``."""
    p = start
    for _ in range(40):
        a, b, c = p * p + p * cxx + kxx, p * cxy + kxy, p * p + p * cyy + kyy
        value = a * c - b * b
        slope = (2.0 * p + cxx) * c + a * (2.0 * p + cyy) - 2.0 * b * cxy
        if p != other:
            slope = slope - value / (p - other)
        if slope == 0.0 or value == 0.0:
            break
        step = value / slope
        p = p - step
        if abs(step) <= 1e-15 * abs(p):
            break
    return p


@njit(cache=True)
def cartesian_modes(x: FloatArray, poles: ComplexArray, residues: ComplexArray) -> None:
    """Modes of one device with cartesian parameters x (12,): writes poles (3,) [rad/s] and residues (3, 2, 2) [rad/s].

    x (14,) ends with the electrode mismatches m_D, m_S [1]: the imbalances of rocking are then d + m_D and s + m_S.

    The rocking poles solve det P(s) = 0 with P(s) = s^2 I + s C + K, and their residues are s adj P / (det P)'.  The result is
    that of :func:`gyro_modes`, a thousand times faster.  Coinciding poles (an exceptional point) are moved 1e-6 rad/s apart,
    which changes the response by less than 1e-9.
    """
    omega0, eps_c, eps_s, c0, d_c, d_s = x[0], x[1], x[2], x[3], x[4], x[5]
    kxx, kyy, kxy = omega0 * (omega0 + eps_c), omega0 * (omega0 - eps_c), omega0 * eps_s
    cxx, cyy, cxy = c0 + d_c, c0 - d_c, d_s
    # First-order slow flow: p = i omega0 - c0/2 +- sqrt(m_c^2 + m_s^2), m = (i eps - d)/2 as complex 2-vectors.
    m_c, m_s = 0.5 * (1j * eps_c - d_c), 0.5 * (1j * eps_s - d_s)
    root = np.sqrt(m_c * m_c + m_s * m_s)
    centre = 1j * omega0 - 0.5 * c0
    p1 = _pole_near(centre - root, np.conj(centre), kxx, kxy, kyy, cxx, cxy, cyy)
    p2 = _pole_near(centre + root, p1, kxx, kxy, kyy, cxx, cxy, cyy)
    if abs(p2 - p1) < 1e-6:
        middle = 0.5 * (p1 + p2)
        p1, p2 = middle - 0.5e-6, middle + 0.5e-6
    if p1.imag > p2.imag:
        p1, p2 = p2, p1
    g_r, g_z = math.exp(x[8]), math.exp(x[9])
    s, d = x[10], x[11]
    s_rocking, d_rocking = s, d
    if x.size == 14:
        d_rocking += x[12]
        s_rocking += x[13]
    for k in range(2):
        p, q = (p1, p2) if k == 0 else (p2, p1)
        a, b, c = p * p + p * cxx + kxx, p * cxy + kxy, p * p + p * cyy + kyy
        # det P = (s - p1)(s - p2)(s - conj p1)(s - conj p2): no cancellation in its slope at a root.
        slope = (p - q) * (p - np.conj(p)) * (p - np.conj(q))
        gain = g_r * p / slope
        poles[k] = p
        # M_S adj(P) M_D, with adj(P) = [[c, -b], [-b, a]].
        for i in range(2):
            row_x, row_y = M_S[i, 0] * c - M_S[i, 1] * b, M_S[i, 1] * a - M_S[i, 0] * b
            k_s = 1.0 - s_rocking if i == 0 else 1.0 + s_rocking
            for j in range(2):
                k_d = 1.0 - d_rocking if j == 0 else 1.0 + d_rocking
                residues[k, i, j] = gain * k_s * (row_x * M_D[0, j] + row_y * M_D[1, j]) * k_d
    omega3, c33 = x[6], x[7]
    p3 = complex(-0.5 * c33, math.sqrt(omega3 * omega3 - 0.25 * c33 * c33))
    poles[2] = p3
    gain3 = g_z * p3 / (p3 - np.conj(p3))
    for i in range(2):
        k_s = 1.0 - s if i == 0 else 1.0 + s
        for j in range(2):
            k_d = 1.0 - d if j == 0 else 1.0 + d
            residues[2, i, j] = gain3 * k_s * k_d
