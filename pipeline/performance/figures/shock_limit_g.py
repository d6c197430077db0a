"""Half-sine shock along z that closes the gap."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import TAU, OpenLoop

STANDARD_GRAVITY = 9.80665


def half_sine_peak(r: FloatArray) -> FloatArray:
    """Largest |x| omega^2 / A (...) of an undamped mode under A sin(pi t / tau), 0 < t < tau; r = omega tau / pi.

    During the pulse, extrema lie at 2 pi n / (1 + r) < pi of the pulse's phase; after it, the mode rings at
    2 r |cos(pi r / 2)| / |1 - r^2|.
    """
    # The limit at r = 1 is pi / 2; there both forms are 0 / 0.
    r = np.where(np.abs(r - 1.0) < 1e-6, 1.0 + 1e-6, r)
    after = 2.0 * r * np.abs(np.cos(0.5 * np.pi * r) / (1.0 - r * r))
    n = np.maximum(np.floor(0.25 * (1.0 + r)), 1.0)
    during = [
        np.where(2.0 * k < 1.0 + r, r / (r - 1.0) * np.sin(2.0 * np.pi * k / (1.0 + r)), 0.0) for k in (n, n + 1.0)
    ]
    return np.asarray(np.maximum(after, np.maximum(*during)))


def value(gyro: OpenLoop) -> FloatArray:
    """Acceleration of the fold, h omega3^2 (g0 - 3/2 u), over the peak of the linear response to a half-sine pulse [g]."""
    duration = gyro.point.operation.shock_ms
    assert duration is not None
    u = np.cbrt(2.0 * gyro.compliance * gyro.bias_v * gyro.gap**2)
    omega3 = TAU * gyro.q["f3_hz"]
    static = omega3**2 * gyro.stiffening * (gyro.gap_at_rest - 1.5 * u) * gyro.metres
    return np.asarray(static / (STANDARD_GRAVITY * half_sine_peak(omega3 * 1e-3 * duration / np.pi)))


FIGURE = Figure(
    name="shock_limit_g",
    unit="g",
    meaning="peak of a half-sine shock along z that takes the drive electrodes to pull-in or contact",
    label="shock limit",
    formula="h omega3^2 (g0 - 3/2 u) / peak,  h = 1 + 2 C_b V_b / g,  u^3 = 2 C V_b g^2,  peak at f3 without damping",
    source="fold of the static equilibrium; half-sine shock spectrum: Harris, Shock and Vibration Handbook, ch. 8",
    needs=("softening_hz_per_v2", "bias_v", "gap_um", "shock_ms"),
    value=value,
)
