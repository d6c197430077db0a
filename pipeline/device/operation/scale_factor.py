"""Scale factor of a force-rebalanced gyro: a line through the indicated rates at several constant rates.

Shapes: B devices, R rates.  Units: rates in deg/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...errors import ConfigError
from .loops import Drive, Loops
from .rebalance import indicated_rate_dps, operate, settled


@dataclass(frozen=True, eq=False)
class ScaleFactor:
    """Indicated rate as a linear function of the true rate, each (B,): slope [1], offset and largest deviation [deg/s]."""

    slope: FloatArray
    offset_dps: FloatArray
    nonlinearity_dps: FloatArray


def scale_factor(
    physical: FloatArray,
    angular_gain: float | FloatArray,
    rates_dps: FloatArray,
    phase_error_deg: float | FloatArray = 0.0,
    drive: Drive | None = None,
    loops: Loops | None = None,
) -> ScaleFactor:
    """Least-squares line through the settled indicated rates at constant ``rates_dps`` (R,) [deg/s], R >= 2.

    Parameters
    ----------
    physical : (B, 12), the columns of ``pipeline.device.gyro.PHYSICAL``.
    angular_gain, phase_error_deg : kappa and phi [deg], (B,) or one number for all devices.
    drive, loops : as in :func:`operate`.

    Raises
    ------
    ConfigError : as in :func:`operate` and :func:`settled`; fewer than two different rates.
    """
    if np.unique(rates_dps).size < 2:
        raise ConfigError(
            "a scale factor needs two rates", value=rates_dps.tolist(), allowed="two or more different rates"
        )
    batch = physical.shape[0]
    shown = np.empty((batch, rates_dps.size))
    for k, rate in enumerate(rates_dps.tolist()):
        found = settled(operate(physical, angular_gain, rate, drive, loops))
        shown[:, k] = indicated_rate_dps(found.inphase_per_s, found.quadrature_per_s, angular_gain, phase_error_deg)
    design = np.stack([rates_dps, np.ones_like(rates_dps)], axis=1)
    line = np.linalg.lstsq(design, shown.T, rcond=None)[0]
    return ScaleFactor(line[0], line[1], np.abs(shown.T - design @ line).max(axis=0))
