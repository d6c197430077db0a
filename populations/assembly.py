"""Parameters of the plant from the structure of a device.

Springs at azimuth phi_j and radius r with stiffness k_j have K_xx = sum k y^2, K_yy = sum k x^2, K_xy = -sum k x y.  Relative
to the nominal K0 = k0 J r^2 / 2 and written as mean and 2-theta anisotropy (see ``symmetric``):

    K / K0 = (S0, -S2),   S0 = sum k_j / (J k0),   S2 = sum k_j exp(2 i phi_j) / (J k0)
    times (1 + e), e: residual anisotropy and stress;   plus electrostatic springs at the drive electrodes (+-45 deg)
    I / I0 = (1 + p |d|^2, -p d^2),   p = mu (m_p / m) / (2 l^2),   d = x + i y the offset of the post
    omega_i^2 = omega0^2 eigenvalues of I^(-1/2) K I^(-1/2)
    omega3^2  = omega30^2 (S0 - softening)
    1/Q = p_gas / Q_gas + 1 / Q_anchor + 1 / Q_thermoelastic,   C = I^(-1/2) (omega0 / Q)(1 + anisotropy) I^(-1/2)
    c11 + c22 = 2 mean,   (c11 - c22)/2 + i c12 = anisotropy exp(-2 i theta)

1-theta quantities couple rocking with up-down.  With zeta = -z, the shape of the up-down mode has, in units of zeta / l and
to first order,

    a_x = -g (-(r/l) Im S1 + (m_p/m) d_y/l),   g = mu omega3^2 / (omega_r^2 - omega3^2)
    S1 = sum k_j exp(i phi_j) / (J k0)

so the updown_tilt is t_x = -a_x.  The tilt about y changes the up-down gain only, and in second order.  The converse, up-down
motion in the rocking modes (of the same order, times -1/mu), is not modelled by any effect and is neglected.

Electrodes: the gain is (V / V0) A / g^2 for a drive and A / g^2 for a sense electrode, times the arm for rocking; the softening
is A V^2 / g^3, times arm^2 for rocking.

Shapes: B devices, J springs, four electrodes D1, D2, S1, S2.  Frequencies in Hz, rates in 1/s, angles in deg, lengths in mm.
Source: the paper, eq. (1), (2), (9), (10), (18), and the derivations above.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.errors import ConfigError
from pipeline.quantities import MODEL

from .changes import COMPLEX, change_shapes, check_change
from .irregularity import CHANGES, Change
from .nominal import NominalDevice
from .symmetric import Symmetric, as_complex, axis_deg, congruence, inverse_root, product, rotated

TAU = 2.0 * math.pi
MAX_DAMPING_ANISOTROPY = 1.0  # up to 1, C is positive semidefinite


@dataclass(frozen=True, eq=False)
class Structure:
    """Sums of all changes of B devices; ``Change`` gives the meaning, unit and shape of each."""

    ln_stiffness: FloatArray
    ln_spring: FloatArray
    azimuth_rad: FloatArray
    anisotropy: ComplexArray
    post_offset_mm: ComplexArray
    ln_area: FloatArray
    ln_gap: FloatArray
    ln_arm: FloatArray
    ln_channel: FloatArray
    ln_pressure: FloatArray
    ln_gas: FloatArray
    ln_anchor: FloatArray
    damping_anisotropy: ComplexArray


def combine(changes: Iterable[tuple[str, Change]], count: int, springs: int) -> Structure:
    """Sum of named changes for ``count`` devices with ``springs`` springs.

    Raises
    ------
    ConfigError : a change has the wrong shape, is complex instead of real, or is not finite.
    """
    shape = change_shapes(count, springs)
    total = {name: np.zeros(shape[name], complex if name in COMPLEX else float) for name in CHANGES}
    for source, change in changes:
        check_change(source, change, count, springs)
        for name in CHANGES:
            part = getattr(change, name)
            if part is not None:
                total[name] = total[name] + part
    return Structure(**total)


def _sum(rows: Iterable[FloatArray]) -> FloatArray:
    # numpy.sum adds in an order that depends on the number of devices; a device must not depend on its batch.
    return reduce(add, rows)


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Relative stiffness [1]: of rocking K / K0, of up-down (B,), and the 1-theta moment S1 (B,) of the springs."""

    rocking: Symmetric
    updown: FloatArray
    moment: ComplexArray


def spring_stiffness(device: NominalDevice, ln_spring: FloatArray, azimuth_rad: FloatArray) -> Stiffness:
    """(S0, -S2), S0 and S1 [1] of springs with ln(k / k0) [1] and azimuth errors [rad], both (J, B)."""
    nominal = np.deg2rad(np.array(device.spring_azimuth_deg))
    # Expanded about the nominal azimuths, so that the moments of a symmetric suspension are exactly zero.
    relative = [np.exp(row) for row in ln_spring]
    share = 1.0 / len(nominal)
    s0 = _sum([k - 1.0 for k in relative]) * share + 1.0

    def moment(order: int) -> ComplexArray:
        at_nominal = np.exp(1j * order * nominal)
        whole = complex(at_nominal.sum()) * share
        changed = [
            (k * np.cos(order * error) - 1.0, k * np.sin(order * error)) for k, error in zip(relative, azimuth_rad)
        ]
        real = _sum([c * a.real - s * a.imag for (c, s), a in zip(changed, at_nominal)]) * share
        imag = _sum([c * a.imag + s * a.real for (c, s), a in zip(changed, at_nominal)]) * share
        if abs(whole) > 1e-12:
            real, imag = real + whole.real, imag + whole.imag
        return as_complex(real, imag)

    return Stiffness(Symmetric(s0, -moment(2)), s0, moment(1))


def stiffness(device: NominalDevice, structure: Structure, bias: float) -> Stiffness:
    """Relative stiffness [1] from springs, anisotropy and electrostatic softening; ``bias`` is V / V0 [1]."""
    springs = spring_stiffness(device, structure.ln_spring, structure.azimuth_rad)
    common = np.exp(structure.ln_stiffness)
    rocking = product(springs.rocking, Symmetric(np.ones_like(common), structure.anisotropy))
    area, gap, arm = structure.ln_area, structure.ln_gap, structure.ln_arm
    unlevered = [bias**2 * np.exp(area[k] - 3.0 * gap[k]) for k in (0, 1)]
    levered = [unlevered[k] * np.exp(2.0 * arm[k]) for k in (0, 1)]
    soft = softening(device)
    soft3 = soft * (device.rocking_hz / device.updown_hz) ** 2 / device.lever
    total = Symmetric(
        common * rocking.mean - soft * ((levered[0] + levered[1]) / 2.0 - 1.0),
        # -S2 of two negative springs at +45 and -45 deg, where exp(2 i phi) = +-i.
        as_complex(
            common * rocking.anisotropy.real,
            common * rocking.anisotropy.imag + 0.5 * soft * (levered[0] - levered[1]),
        ),
    )
    updown = common * springs.updown - soft3 * ((unlevered[0] + unlevered[1]) / 2.0 - 1.0)
    return Stiffness(total, updown, common * springs.moment)


def softening(device: NominalDevice) -> float:
    """Relative reduction of K0 by both drive electrodes at the nominal bias [1]: -2 df / f0."""
    return -2.0 * device.softening_hz_per_v2 * device.nominal_bias_v**2 / device.rocking_hz


def inertia(device: NominalDevice, offset_mm: ComplexArray) -> Symmetric:
    """I / I0 [1], post off centre by ``offset_mm`` (B,) [mm]: I_xx += m_p y^2, I_yy += m_p x^2, I_xy -= m_p x y."""
    x, y = offset_mm.real / device.arm_mm, offset_mm.imag / device.arm_mm
    weight = device.lever * device.post_mass_fraction / 2.0
    return Symmetric(1.0 + weight * (x * x + y * y), as_complex(weight * (y * y - x * x), -2.0 * weight * x * y))


def inverse_quality(device: NominalDevice, structure: Structure, pressure: float) -> tuple[FloatArray, FloatArray]:
    """1/Q (B,) [1] of rocking and up-down; ``pressure`` is p / p0 [1]."""
    other = 1.0 / device.quality_anchor + 1.0 / device.quality_thermoelastic
    gas = [1.0 / total - other for total in (device.quality_rocking, device.quality_updown)]
    gas_loss = [pressure * np.exp(structure.ln_pressure + ln) for ln in structure.ln_gas]
    anchor = np.exp(structure.ln_anchor)
    # Expanded about the nominal total, so that a nominal device has exactly the nominal Q.
    first, second = (
        1.0 / total + (share * (loss - 1.0) + (anchor - 1.0) / device.quality_anchor)
        for total, share, loss in zip((device.quality_rocking, device.quality_updown), gas, gas_loss)
    )
    return first, second


def parameters(device: NominalDevice, structure: Structure, bias: float, pressure: float) -> dict[str, FloatArray]:
    """The parameters of ``pipeline.quantities.MODEL`` by name, each (B,) [units of MODEL].

    Parameters
    ----------
    device : the nominal device.
    structure : its changes.
    bias, pressure : V / V0 and p / p0.

    Raises
    ------
    ConfigError : a device has no positive stiffness.
    """
    k = stiffness(device, structure, bias)
    root = inverse_root(inertia(device, structure.post_offset_mm))
    normalised = congruence(root, k.rocking)
    size = np.hypot(normalised.anisotropy.real, normalised.anisotropy.imag)
    if not (np.all(normalised.mean > size) and np.all(k.updown > 0.0)):
        raise ConfigError(
            "the population contains a device without a positive stiffness",
            value=float(np.min(normalised.mean - size)),
            allowed="eigenvalues of K / K0 above 0",
            next_step="lower the spreads or the bias of the population",
        )
    f1 = device.rocking_hz * np.sqrt(normalised.mean - size)
    f2 = device.rocking_hz * np.sqrt(normalised.mean + size)
    f3 = device.updown_hz * np.sqrt(k.updown)
    theta_deg = axis_deg(normalised.anisotropy)

    loss, loss3 = inverse_quality(device, structure, pressure)
    rate = TAU * device.rocking_hz * loss
    modulus = np.hypot(structure.damping_anisotropy.real, structure.damping_anisotropy.imag)
    limited = structure.damping_anisotropy / np.maximum(modulus / MAX_DAMPING_ANISOTROPY, 1.0)
    c = congruence(root, Symmetric(rate, rate * limited))
    along = rotated(c.anisotropy, theta_deg)

    updown, rocking = electrode_gains(structure, bias)
    mean = [(rocking[0] + rocking[1]) / 2.0, (rocking[2] + rocking[3]) / 2.0]
    mean3 = [(updown[0] + updown[1]) / 2.0, (updown[2] + updown[3]) / 2.0]
    square = root.mean * root.mean
    found = {
        "theta_deg": theta_deg,
        "split_hz": f2 - f1,
        "f1_hz": f1,
        "f2_hz": f2,
        "f3_hz": f3,
        "zeta1": (c.mean + along.real) / (2.0 * TAU * f1),
        "zeta2": (c.mean - along.real) / (2.0 * TAU * f2),
        "zeta3": TAU * device.updown_hz * loss3 / (2.0 * TAU * f3),
        "c12_per_s": np.ascontiguousarray(along.imag),
        "rocking_gain": device.rocking_gain_per_s * square * mean[0] * mean[1],
        "updown_gain": device.updown_gain_per_s * mean3[0] * mean3[1],
        "sense_imbalance": imbalance(updown[2], updown[3]),
        "drive_imbalance": imbalance(updown[0], updown[1]),
    }
    return {quantity.name: found[quantity.name] for quantity in MODEL}


def electrode_gains(structure: Structure, bias: float) -> tuple[list[FloatArray], list[FloatArray]]:
    """Relative gains [1] of D1, D2, S1, S2, each (B,), for up-down and for rocking; ``bias`` is V / V0."""
    volts = (bias, bias, 1.0, 1.0)
    ln = [structure.ln_area[k] - 2.0 * structure.ln_gap[k] + structure.ln_channel[k] for k in range(4)]
    updown = [volts[k] * np.exp(ln[k]) for k in range(4)]
    rocking = [volts[k] * np.exp(ln[k] + structure.ln_arm[k]) for k in range(4)]
    return updown, rocking


def imbalance(first: FloatArray, second: FloatArray) -> FloatArray:
    """(K_2 - K_1) / (K_2 + K_1) (B,) [1]."""
    return (second - first) / (second + first)


def effects(
    device: NominalDevice, structure: Structure, bias: float, plant: dict[str, FloatArray]
) -> dict[str, dict[str, FloatArray]]:
    """Sizes of the effects of the same structure that are not parameters of the plant: effect -> parameter -> (B,).

        1/g [1/(V s)] = s0 omega0^2 / (2 G_r V0) exp(-ln_gap) / K_S,   s0 the nominal ``softening``

    because motion is measured in pick-off volts, where the force K_D V_b x / g at both drives lowers omega^2 by
    2 G_r V_b / g.  ``plant`` contains the parameters of :func:`parameters`.
    """
    k = stiffness(device, structure, bias)
    updown, rocking = electrode_gains(structure, bias)
    offset_y = structure.post_offset_mm.imag / device.arm_mm
    f3, fr = plant["f3_hz"], (plant["f1_hz"] + plant["f2_hz"]) / 2.0
    g = device.lever * f3 * f3 / (fr * fr - f3 * f3)
    t_x = g * (device.post_mass_fraction * offset_y - device.spring_radius * k.moment.imag)
    nominal = softening(device) * (TAU * device.rocking_hz) ** 2
    nominal = nominal / (2.0 * device.rocking_gain_per_s * device.nominal_bias_v)
    volts = (updown[2] + updown[3]) / 2.0
    gap = structure.ln_gap
    return {
        "updown_tilt": {"t_x": t_x},
        "electrode_mismatch": {
            "m_S": imbalance(rocking[2], rocking[3]) - imbalance(updown[2], updown[3]),
            "m_D": imbalance(rocking[0], rocking[1]) - imbalance(updown[0], updown[1]),
        },
        "electrostatic_softening": {"1/g": nominal * np.exp(-(gap[0] + gap[1]) / 2.0) / volts},
        "sense_nonlinearity": {"1/g": nominal * np.exp(-(gap[2] + gap[3]) / 2.0) / volts},
        "drive_nonlinearity": {"eps": np.ones_like(f3)},
    }
