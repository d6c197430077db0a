"""How the rate bias of the rebalanced gyro moves with temperature."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..figure import Figure
from ..open_loop import OpenLoop


def value(gyro: OpenLoop) -> FloatArray:
    """TCF quadrature_bias + TC_c inphase_bias [deg/s/K]."""
    damping = gyro.point.operation.damping_ppm_per_c
    assert damping is not None
    quadrature, inphase = gyro.q["quadrature_bias_dps"], gyro.q["inphase_bias_dps"]
    return np.asarray(1e-6 * (gyro.point.tcf_ppm_per_c * quadrature + damping * inphase))


FIGURE = Figure(
    name="rate_bias_dps_per_c",
    unit="deg/s/K",
    meaning="change of rate_bias_dps per kelvin, by the temperature coefficients of the frequencies and of the damping",
    label="rate bias over temperature",
    formula="TCF quadrature_bias_dps + TC_c inphase_bias_dps: the split scales with the frequencies, the damping torque with c",
    source="derivative of the paper's eq. (6); TCF -28 ppm/K: Hopcroft et al., J. MEMS 19 (2010) 229",
    needs=("angular_gain", "damping_ppm_per_c"),
    value=value,
)
