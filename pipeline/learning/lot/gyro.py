"""Coordinates in which the devices of a gyro lot are nearly linear in their irregularities.

    k = (f1^2 + f2^2)/2,   k3 = f3^2                             mean rocking and up-down stiffness over inertia
    a = -(f2^2 - f1^2) / (f2^2 + f1^2) exp(2 i theta)            components x (0 deg) and y (45 deg)
    c = 2 pi (zeta1 f1 + zeta2 f2),    d = (2 pi (zeta1 f1 - zeta2 f2) + i c12) exp(2 i theta) / c
    logarithms of c, c3 = 4 pi zeta3 f3 and of both gains; imbalances as they are

Springs and electrostatic softening add up in k and k3, so these are exact where logarithms of the frequencies would be curved.
split and theta are a badly behaved pair (theta is undefined at split 0); a is normal where its causes are.  The map is one to
one, so that a device drawn in these coordinates has all quantities that limits are given for.

Shapes: B devices.  Source: the paper, eq. (2), (18); ``populations/assembly.py`` derives K and C from the same components.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...arrays import FloatArray

TAU = 2.0 * np.pi
#: The parameters that the coordinates are made of, in the order of ``pipeline.quantities.MODEL``.
NEEDED = (
    "theta_deg", "split_hz", "f1_hz", "f2_hz", "f3_hz", "zeta1", "zeta2", "zeta3", "c12_per_s",
    "rocking_gain", "updown_gain", "sense_imbalance", "drive_imbalance",
)  # fmt: skip
UNITS = ("Hz^2", "1", "1", "Hz^2", *("1",) * 8)
COORDINATES = (
    "rocking_hz2", "anisotropy_x", "anisotropy_y", "updown_hz2", "ln_damping", "damping_anisotropy_x",
    "damping_anisotropy_y", "ln_updown_damping", "ln_rocking_gain", "ln_updown_gain", "sense_imbalance", "drive_imbalance",
)  # fmt: skip
MEANINGS = {
    "rocking_hz2": "mean square of the rocking frequencies",
    "anisotropy_x": "stiffness anisotropy along 0 and 90 deg",
    "anisotropy_y": "stiffness anisotropy along +-45 deg",
    "updown_hz2": "square of the up-down frequency",
    "ln_damping": "ln of the rocking damping rate [1/s]",
    "damping_anisotropy_x": "damping anisotropy along 0 and 90 deg",
    "damping_anisotropy_y": "damping anisotropy along +-45 deg",
    "ln_updown_damping": "ln of the up-down damping rate [1/s]",
    "ln_rocking_gain": "ln of the rocking gain [1/s]",
    "ln_updown_gain": "ln of the up-down gain [1/s]",
    "sense_imbalance": "sense imbalance",
    "drive_imbalance": "drive imbalance",
}


def coordinates(p: Mapping[str, FloatArray]) -> FloatArray:
    """(B, 12) [``UNITS``] in the order of ``COORDINATES`` from the parameters ``NEEDED``, each (B,) [units of MODEL]."""
    f1, f2 = p["f1_hz"], p["f2_hz"]
    turn = np.exp(2j * np.deg2rad(p["theta_deg"]))
    square = 0.5 * (f1 * f1 + f2 * f2)
    # f2^2 - f1^2 from the split, which is known better than the difference of f1 and f2.
    anisotropy = -p["split_hz"] * (f1 + f2) / (2.0 * square) * turn
    first, second = TAU * p["zeta1"] * f1, TAU * p["zeta2"] * f2
    damping = first + second
    # C = mean (1 + d): along theta it is c11 - c22 = 2 mean Re, and the mean is (c11 + c22)/2 = first + second.
    d = (first - second + 1j * p["c12_per_s"]) * turn / damping
    return np.stack(
        [
            square,
            anisotropy.real,
            anisotropy.imag,
            p["f3_hz"] ** 2,
            np.log(damping),
            d.real,
            d.imag,
            np.log(2.0 * TAU * p["zeta3"] * p["f3_hz"]),
            np.log(p["rocking_gain"]),
            np.log(p["updown_gain"]),
            p["sense_imbalance"],
            p["drive_imbalance"],
        ],
        axis=-1,
    )


def parameters(c: FloatArray) -> dict[str, FloatArray]:
    """The reverse of :func:`coordinates` for (.., 12): each (..) [units of MODEL]."""
    anisotropy = c[..., 1] + 1j * c[..., 2]
    size = np.minimum(np.abs(anisotropy), 1.0 - 1e-9)
    f1, f2 = np.sqrt(c[..., 0] * (1.0 - size)), np.sqrt(c[..., 0] * (1.0 + size))
    f3 = np.sqrt(c[..., 3])
    double = np.angle(-anisotropy)
    theta = 0.5 * np.rad2deg(double)
    theta = np.where(theta <= -90.0, theta + 180.0, theta)
    damping = np.exp(c[..., 4])
    d = (c[..., 5] + 1j * c[..., 6]) * np.exp(-1j * double) * damping
    return {
        "theta_deg": theta,
        "split_hz": f2 - f1,
        "f1_hz": f1,
        "f2_hz": f2,
        "f3_hz": f3,
        "zeta1": (damping + d.real) / (2.0 * TAU * f1),
        "zeta2": (damping - d.real) / (2.0 * TAU * f2),
        "zeta3": np.exp(c[..., 7]) / (2.0 * TAU * f3),
        "c12_per_s": d.imag,
        "rocking_gain": np.exp(c[..., 8]),
        "updown_gain": np.exp(c[..., 9]),
        "sense_imbalance": c[..., 10],
        "drive_imbalance": c[..., 11],
    }


def propagated(values: Mapping[str, FloatArray], sd: Mapping[str, FloatArray]) -> FloatArray:
    """(B, 12, 12) covariance of the coordinates from the sd (B,) of the parameters, to first order.

    f1 and f2 enter through their mean, whose sd is that of one of them or less; split has its own sd.  Correlations between the
    parameters of one device are not stored with a run, and are taken as zero.
    """
    at = {name: np.asarray(values[name], dtype=np.float64) for name in NEEDED}
    base = coordinates(at)
    rows: list[FloatArray] = []
    for name in NEEDED:
        step = np.nan_to_num(np.asarray(sd.get(name, np.zeros(len(base)))), posinf=0.0)
        moved = coordinates({**at, name: at[name] + step})
        rows.append(moved - base)
    jacobian = np.stack(rows, axis=-1)
    return np.asarray(jacobian @ jacobian.transpose(0, 2, 1))
