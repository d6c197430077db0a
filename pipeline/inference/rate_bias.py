"""Rate bias of a device from posterior draws, with its uncertainty.

    rate_bias = Omega_Q tan(phi) + inphase_bias,      Omega_Q = (w1^2 - w2^2) sin 2theta / (4 kappa omega0)

See ``pipeline.device.operation.bias`` for the symbols.  The draws give frequencies, axes and damping; the angular gain kappa and
the demodulation phase error phi are each known to a standard deviation and are drawn too.

Shapes: n draws of 12 physical parameters.  Units: deg/s, deg.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..device.operation.bias import rate_biases_dps
from ..device.operation.rebalance import self_oscillation_hz
from ..errors import ConfigError
from ..experiment.systematic import Systematic
from .estimate import RateSettings, intervals
from .systematic import demodulated


def bias_draws(
    draws: FloatArray,
    angular_gain: float | FloatArray,
    phase_error_deg: float | FloatArray,
    drive: Literal["f1", "f2", "locked"] = "locked",
) -> dict[str, FloatArray]:
    """The rate biases of ``pipeline.device.operation.bias`` [deg/s], each (n,), of physical draws (n, 12).

    Parameters
    ----------
    draws : (n, 12), the columns of ``pipeline.device.gyro.PHYSICAL``.
    angular_gain, phase_error_deg : kappa and phi [deg], scalar or (n,).
    drive : the mode that sets omega0; "locked" is the frequency at which the locked drive loop oscillates.

    Raises
    ------
    ConfigError : an angular gain that is not positive, or |phi| >= 90 deg.
    """
    phi = np.asarray(phase_error_deg, dtype=np.float64)
    if not np.all(np.abs(phi) < 90.0):
        raise ConfigError("demodulation phase error too large", value=phase_error_deg, allowed="(-90, 90) deg")
    found = rate_biases_dps(draws, angular_gain, 0.0, "f2" if drive == "f2" else "f1")
    quadrature = found["quadrature_rate_dps"]
    if drive == "locked":
        quadrature = quadrature * draws[..., 0] / self_oscillation_hz(draws)
    leaked = quadrature * np.tan(np.deg2rad(phi))
    inphase = found["inphase_bias_dps"]
    return {
        "quadrature_rate_dps": quadrature,
        "quadrature_bias_dps": leaked,
        "inphase_bias_dps": inphase,
        "rate_bias_dps": leaked + inphase,
    }


def bias_from_posterior(
    draws: FloatArray,
    angular_gain: tuple[float, float],
    phase_error_deg: tuple[float, float],
    random: np.random.Generator,
    drive: Literal["f1", "f2", "locked"] = "locked",
) -> dict[str, float]:
    """Median, sd and 90 % interval of each rate bias: <q>, <q>_sd, <q>_q05, <q>_q95 [deg/s].

    Parameters
    ----------
    draws : physical (n, 12), the columns of ``pipeline.device.gyro.PHYSICAL``.
    angular_gain : kappa and its sd (0: exact); drawn lognormal with that median and relative sd.
    phase_error_deg : phi and its sd [deg] (0: exact); drawn normal.
    random : stream of these draws.
    drive : as for :func:`bias_draws`.

    Raises
    ------
    ConfigError : kappa not positive, a negative sd, or |phi| + 10 sd of 90 deg or more.
    """
    (kappa, kappa_sd), (phi, phi_sd) = angular_gain, phase_error_deg
    if not (kappa > 0.0 and kappa_sd >= 0.0 and phi_sd >= 0.0):
        raise ConfigError("the angular gain must be positive and no sd negative", value=(angular_gain, phase_error_deg))
    if not abs(phi) + 10.0 * phi_sd < 90.0:
        raise ConfigError(
            "demodulation phase error too large", value=phase_error_deg, allowed="|phi| + 10 sd below 90 deg"
        )
    known = RateSettings(kappa, phi, "f1", Systematic(phase_error_sd_deg=phi_sd, angular_gain_sd=kappa_sd))
    drawn = demodulated(known, random.standard_normal((draws.shape[0], len(known.systematic.sds))))
    assert drawn.angular_gain is not None
    return intervals(bias_draws(draws, drawn.angular_gain, drawn.phase_error_deg, drive))
