"""Electronic trim: electrostatic springs from trim electrodes (an outlook of the paper).

A pair of opposite electrodes at azimuth beta with bias V acts as a negative spring

    K_e = -k_e V^2 n n^T,   n = (cos beta, sin beta),   k_e = 4 pi omega |s|         [(rad/s)^2 / V^2]

where s is the softening [Hz/V^2] of a rocking mode along n (eps A V^2 / g^3 times the squared lever arm, over the inertia).  With
the mean m and the complex anisotropy a of K, K = m I + [[Re a, Im a], [Im a, -Re a]], and u_e = V_e^2, the trim is linear:

    m' = m - 1/2 sum k_e u_e,      a' = a - 1/2 sum k_e u_e exp(2 i beta_e),      C unchanged in the x, y frame
    omega_2^2 - omega_1^2 = 2 |a'|,      -a' = |a'| exp(2 i theta),      Omega_Q = Im a' / (2 kappa omega0)
    omega_3'^2 = omega_3^2 - sum k_e u_e G_z / (2 G_r)        (electrodes at the drive electrodes' arm: M_D^T M_D = 2)

The gains k_e have a relative sd, independent between pairs.  The plan is the u that minimises the expected squared distance of
a' from its target a_t, given that K was measured at u_0:

    E |a' - a_t|^2 = |<a> - a_t - 1/2 sum <k_e> (u_e - u_0e) exp(2 i beta_e)|^2
                   + 1/4 sum var(k_e) (u_e - u_0e)^2 + const,                        0 <= u_e <= V_max^2

This is a bounded least-squares problem, solved exactly by scipy's lsq_linear (BVLS).  The second term makes the solution unique
and keeps the voltages small.

Shapes: n draws, B devices, E electrode pairs.  Units: V, Hz, deg; K in (rad/s)^2, mass-normalised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, ComplexArray, FloatArray
from ...errors import ConfigError
from ..gyro import TAU, split_hz, to_cartesian, to_physical
from .trim_electrodes import Electrodes

#: Smallest gain uncertainty for which the plan is made; it keeps the solution unique.
_LEAST_SD = 1e-6


@dataclass(frozen=True)
class Target:
    """Target of a trim.

    With split_hz and theta_deg: this split, with the lower axis at theta.  With split_hz only: this split, with the axes
    unchanged.  With theta_deg only: one of the two axes at theta (at 0 or 90 deg the quadrature vanishes), with any split.

    Raises
    ------
    ConfigError : neither is given, or the split [Hz] is negative or not finite.
    """

    split_hz: float | None = 0.0
    theta_deg: float | None = None

    def __post_init__(self) -> None:
        if self.split_hz is None and self.theta_deg is None:
            raise ConfigError("a trim target needs a split or an angle", allowed="split_hz, theta_deg or both")
        if self.split_hz is not None and not 0.0 <= self.split_hz < float("inf"):
            raise ConfigError("the target split must not be negative", value=self.split_hz, allowed=">= 0 Hz")


@dataclass(frozen=True, eq=False)
class TrimResult:
    """Trim of one device.

    voltages_v, at_limit : (E,) [V], and whether each is at V_max.
    before, after : physical draws (n, 12) at the measurement and after the trim, with the uncertainty of the gains.
    missing_hz : distance of the planned anisotropy from its target, as a split [Hz]: due to a voltage limit, or, without one,
        the fraction gain_sd^2 by which the plan stays short.
    shift_hz : planned change of the mean rocking frequency [Hz].
    """

    voltages_v: FloatArray
    at_limit: BoolArray
    before: FloatArray
    after: FloatArray
    missing_hz: float
    shift_hz: float


def _mean_and_anisotropy(cartesian: FloatArray) -> tuple[FloatArray, ComplexArray]:
    omega0 = cartesian[..., 0]
    return omega0**2, np.asarray(omega0 * (cartesian[..., 1] + 1j * cartesian[..., 2]), dtype=np.complex128)


def trimmed_physical(
    physical: FloatArray,
    voltages_v: FloatArray,
    electrodes: Electrodes,
    gains: FloatArray | None = None,
    present_v: FloatArray | None = None,
) -> FloatArray:
    """K' = K - sum k_e (V_e^2 - V_0e^2) n n^T with C unchanged: physical parameters (..., 12) under trim voltages.

    Parameters
    ----------
    physical : (..., 12), as measured at ``present_v``.
    voltages_v : (..., E) [V].
    electrodes : pairs with their nominal gains.
    gains : ratio of true to nominal gains (..., E); 1 by default.
    present_v : (..., E) [V]; 0 by default.

    Raises
    ------
    ConfigError : voltages of the wrong length or not finite; electrostatic pull-in (K' is not positive definite).
    """
    pairs = len(electrodes.azimuth_deg)
    for name, value in (("voltages_v", voltages_v), ("present_v", present_v)):
        if value is not None and (value.shape[-1:] != (pairs,) or not np.all(np.isfinite(value))):
            raise ConfigError(
                f"{name} does not fit the electrodes", value=value.shape, allowed=f"(..., {pairs}), finite"
            )
    u = voltages_v**2 - (0.0 if present_v is None else present_v**2)
    pull = np.array(electrodes.gain_per_v2) * u * (1.0 if gains is None else gains)
    x = to_cartesian(physical)
    mean, anisotropy = _mean_and_anisotropy(x)
    anisotropy = anisotropy - 0.5 * (pull @ electrodes.directions())
    total = pull.sum(axis=-1)
    mean = mean - 0.5 * total
    third = x[..., 6] ** 2 - 0.5 * total * np.exp(x[..., 9] - x[..., 8])
    if not (np.all(mean > np.abs(anisotropy)) and np.all(third > 0.0)):
        raise ConfigError(
            "the trim voltages cause electrostatic pull-in",
            value=float(np.max(np.abs(voltages_v))),
            allowed="voltages that leave K positive definite",
            next_step="lower most_v or correct the trim gains",
        )
    shape = np.broadcast_shapes(x.shape[:-1], mean.shape)
    out = np.broadcast_to(x, (*shape, 12)).copy()
    omega0 = np.sqrt(mean)
    out[..., 0], out[..., 6] = omega0, np.sqrt(third)
    out[..., 1], out[..., 2] = anisotropy.real / omega0, anisotropy.imag / omega0
    after = to_physical(out)
    # Copied, so that gains and imbalances are bit-identical.
    after[..., 8:] = physical[..., 8:]
    return after


def _solve(
    mean: float, anisotropy: complex, electrodes: Electrodes, target: Target, present: FloatArray
) -> tuple[FloatArray, float]:
    """Planned u = V^2 (E,) [V^2] and the distance |a' - a_t| [(rad/s)^2], from m, a and u_0 (E,)."""
    from scipy.optimize import lsq_linear  # loading it takes a quarter of a second, and few runs trim

    half = 0.5 * np.array(electrodes.gain_per_v2)
    # In units of the gain of the strongest pair, so that the scale of K does not affect the conditioning.
    unit = float(half.max())
    columns = half / unit * electrodes.directions()
    spread = np.diag(half / unit * max(electrodes.gain_sd, _LEAST_SD))
    most = electrodes.most_v**2
    # Rows: components of a' - a_t along and across the axis exp(2 i theta); a target may constrain only one of them.
    theta = np.angle(-anisotropy) / 2.0 if target.theta_deg is None else np.deg2rad(target.theta_deg)
    axis = np.exp(2j * theta)
    u = present
    # The split in Hz depends on the mean frequency, which the plan shifts by less than 1 %: a fast fixed-point iteration.
    for _ in range(1 if not target.split_hz else 6):
        goal_split = 0.0
        if target.split_hz:
            split = TAU * target.split_hz
            goal_split = split * np.sqrt(max(mean - float(half @ (u - present)) - split**2 / 4.0, 0.0))
        left = (anisotropy + goal_split * axis) / unit
        rows, goal = columns / axis, left / axis
        a = np.stack([rows.real, rows.imag]) if target.split_hz is not None else rows.imag[None]
        b = np.array([goal.real, goal.imag]) if target.split_hz is not None else np.array([goal.imag])
        system, right = np.concatenate([a, spread]), np.concatenate([b, np.zeros(spread.shape[0])])
        found = lsq_linear(system, right, bounds=(-present, most - present), method="bvls", tol=1e-14)
        u = np.clip(present + found.x, 0.0, most)
    return u, unit * float(np.linalg.norm(a @ (u - present) - b))


def _checked(physical: FloatArray, present_v: FloatArray, electrodes: Electrodes) -> None:
    if (
        physical.ndim != 2
        or physical.shape[1] != 12
        or physical.shape[0] == 0
        or not np.all(np.isfinite(physical[:, :8]))
    ):
        raise ConfigError("trimming needs parameters", value=physical.shape, allowed="(n, 12), finite, n at least 1")
    fits = present_v.shape[-1:] == (len(electrodes.azimuth_deg),)
    if not fits or not np.all((present_v >= 0.0) & (present_v <= electrodes.most_v)):
        raise ConfigError(
            "the present trim voltages are out of range",
            value=present_v.tolist(),
            allowed=f"{len(electrodes.azimuth_deg)} of them, 0 to {electrodes.most_v:g} V",
        )


def trim(
    draws: FloatArray,
    electrodes: Electrodes,
    target: Target,
    random: np.random.Generator,
    present_v: FloatArray | None = None,
) -> TrimResult:
    """Plan the trim voltages of one device from its posterior, and predict its posterior after the trim.

    Parameters
    ----------
    draws : physical parameters (n, 12), measured at ``present_v``.
    electrodes : pairs, gains with their uncertainty, and voltage limit.
    target : split and angle to reach.
    random : stream for the uncertainty of the gains.
    present_v : voltages (E,) at the measurement [V]; 0 by default.  With the voltages of a first trim, a second trim corrects
        the error that the gains caused in the first.

    Raises
    ------
    ConfigError : no draws, draws that are not finite, present voltages out of range, or electrostatic pull-in.
    """
    pairs = len(electrodes.azimuth_deg)
    present = np.zeros(pairs) if present_v is None else np.asarray(present_v, dtype=np.float64)
    _checked(draws, present, electrodes)
    mean, anisotropy = _mean_and_anisotropy(to_cartesian(draws))
    middle, centre = float(np.mean(mean)), complex(np.mean(anisotropy))
    u, missing = _solve(middle, centre, electrodes, target, present**2)
    voltages = np.sqrt(u)
    after = trimmed_physical(draws, voltages, electrodes, electrodes.draw_gains(random, draws.shape[0]), present)
    lowered = middle - 0.5 * float(np.array(electrodes.gain_per_v2) @ (u - present**2))
    return TrimResult(
        voltages_v=voltages,
        at_limit=u >= electrodes.most_v**2 * (1.0 - 1e-12),
        before=draws,
        after=after,
        missing_hz=missing / np.sqrt(lowered) / TAU,
        shift_hz=(np.sqrt(lowered) - np.sqrt(middle)) / TAU,
    )


@dataclass(frozen=True, eq=False)
class TrimmedBatch:
    """Devices after the trim: physical (B, 12), voltages_v [V] and at_limit (B, E), split_hz (B,) [Hz] without cancellation."""

    physical: FloatArray
    voltages_v: FloatArray
    at_limit: BoolArray
    split_hz: FloatArray


def trim_batch(
    physical: FloatArray, electrodes: Electrodes, target: Target, gains: FloatArray, rounds: int = 1
) -> TrimmedBatch:
    """Trim a batch of devices, whose parameters are measured with negligible error, ``rounds`` times.

    Parameters
    ----------
    physical : true parameters (B, 12) [units of ``PHYSICAL``].
    electrodes, target : as in :func:`trim`; the plan uses the nominal gains.
    gains : ratio of true to nominal gains (B, E), from ``electrodes.draw_gains``.
    rounds : number of measurements and trims, at least 1.

    Raises
    ------
    ConfigError : as in :func:`trim`; gains of the wrong shape; fewer than one round.
    """
    pairs = len(electrodes.azimuth_deg)
    voltages = np.zeros((physical.shape[0], pairs))
    _checked(physical, voltages, electrodes)
    if gains.shape != voltages.shape:
        raise ConfigError("gains have the wrong shape", value=gains.shape, allowed=f"{voltages.shape}")
    if rounds < 1:
        raise ConfigError("rounds must be at least 1", value=rounds, allowed="1 or more rounds")
    found = physical
    for _ in range(rounds):
        mean, anisotropy = _mean_and_anisotropy(to_cartesian(found))
        plans = zip(mean.tolist(), anisotropy.tolist(), voltages)
        solved = [_solve(m, a, electrodes, target, present**2)[0] for m, a, present in plans]
        voltages = np.sqrt(np.stack(solved))
        # From the untrimmed device, so that rounding errors do not accumulate.
        found = trimmed_physical(physical, voltages, electrodes, gains)
    limit = voltages >= electrodes.most_v * (1.0 - 1e-12)
    return TrimmedBatch(found, voltages, limit, split_hz(to_cartesian(found)))
