"""Temperature of the packaged device: the stiffness of silicon falls with temperature.

    df/f = TCF (T - T0)   =>   d ln k = 2 ln(1 + TCF (T - T0)),   T = operating temperature + N(0, s)

TCF is ``tcf_ppm_per_k``, T_0 the temperature at which the device has its nominal frequencies, and s the sd ``spread_k``.

Source: TCF of -28 ppm/K for silicon resonators, Hopcroft, Nix, Kenny, J. MEMS 19 (2010) 229; temperature spread of the test
assumed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_stiffness (B,) [1] of each package during its test."""
    above = site.operating.temperature_c - site.device.nominal_temperature_c
    kelvin = above + p["spread_k"] * site.normal("package")[0]
    return Change(ln_stiffness=2.0 * np.log1p(1e-6 * p["tcf_ppm_per_k"] * kelvin))


IRREGULARITY = Irregularity(
    name="temperature",
    stage="package",
    parameters=(
        IrregularityParameter(
            "tcf_ppm_per_k", "ppm/K", -1000.0, 1000.0, "temperature coefficient of the mode frequencies"
        ),
        IrregularityParameter("spread_k", "K", 0.0, 100.0, "sd of the temperature of a device during its test"),
    ),
    source="Hopcroft et al., J. MEMS 19 (2010) 229",
    act=act,
    latex=r"\Delta \ln k = 2 \ln \left( 1 + \text{TCF}\,(T - T_0) \right), \quad T \sim N(T_\text{operating}, s)",
)
