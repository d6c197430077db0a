"""The result quantities <q>: one name, one unit, one meaning, from the posterior to the Parquet columns.

``MODEL`` are the parameters of plant "gyro" with offdiagonal_damping; ``DERIVED`` follow from them; ``PERFORMANCE`` follow from
them and from the declared operation (``pipeline/performance``, one file each).
Columns of a quantity: <q>, <q>_sd, <q>_q05, <q>_q95; for a virtual device also true_<q> and fab_<q>.
"""

from __future__ import annotations

from dataclasses import dataclass

from .performance.figure import find_figures


@dataclass(frozen=True)
class Quantity:
    """A result quantity: its unit and what it means; ``axis`` marks an angle modulo 180 deg."""

    name: str
    unit: str
    meaning: str
    axis: bool = False


MODEL: tuple[Quantity, ...] = (
    Quantity(
        "theta_deg",
        "deg",
        "angle of the lower-frequency principal stiffness axis from the x axis, in the frame of the electrodes, as is its sd",
        True,
    ),
    Quantity("split_hz", "Hz", "(omega2 - omega1)/2pi, omega_i^2 the eigenvalues of M^-1 K"),
    Quantity("f1_hz", "Hz", "undamped frequency of the lower rocking axis"),
    Quantity("f2_hz", "Hz", "undamped frequency of the upper rocking axis"),
    Quantity("f3_hz", "Hz", "undamped frequency of the up-down mode"),
    Quantity("zeta1", "1", "damping ratio c11 / (2 omega1)"),
    Quantity("zeta2", "1", "damping ratio c22 / (2 omega2)"),
    Quantity("zeta3", "1", "damping ratio of the up-down mode"),
    Quantity("c12_per_s", "1/s", "off-diagonal damping in the stiffness axes"),
    Quantity("rocking_gain", "1/s", "drive volts to rocking motion in pick-off volts, l^2 K_S K_D / I_0p"),
    Quantity("updown_gain", "1/s", "drive volts to up-down motion in pick-off volts, K_S K_D / m"),
    Quantity("sense_imbalance", "1", "(K_S2 - K_S1)/(K_S2 + K_S1)"),
    Quantity("drive_imbalance", "1", "(K_D2 - K_D1)/(K_D2 + K_D1)"),
)

DERIVED: tuple[Quantity, ...] = (
    Quantity("quality1", "1", "quality factor 1 / (2 zeta1)"),
    Quantity("quality2", "1", "quality factor 1 / (2 zeta2)"),
    Quantity("quality3", "1", "quality factor 1 / (2 zeta3)"),
    Quantity("quadrature_rate_dps", "deg/s", "rate equivalent of the quadrature torque before demodulation"),
    Quantity("quadrature_bias_dps", "deg/s", "rate bias that quadrature leaves at the demodulation phase error"),
    Quantity("inphase_bias_dps", "deg/s", "rate bias of the damping torque, in phase with the rate"),
    Quantity("rate_bias_dps", "deg/s", "quadrature_bias_dps + inphase_bias_dps"),
)

PERFORMANCE: tuple[Quantity, ...] = tuple(
    Quantity(figure.name, figure.unit, figure.meaning + figure.condition) for figure in find_figures().values()
)

#: The quantities that the records alone determine, apart from the angular gain and the demodulation.
IDENTIFIED: tuple[Quantity, ...] = MODEL + DERIVED
QUANTITIES: tuple[Quantity, ...] = IDENTIFIED + PERFORMANCE
NAMES: tuple[str, ...] = tuple(quantity.name for quantity in QUANTITIES)
AXES: frozenset[str] = frozenset(quantity.name for quantity in QUANTITIES if quantity.axis)
