"""Leaking lids: a few packages have a much higher pressure and therefore a low Q.

    with probability ``fraction``: ln(p / p_lid) += max(N(ln_mean, ln_spread), 0)

q is ``fraction``, m is ``ln_mean`` and s is ``ln_spread``.  The pressure p is that under the lid.

Source: seal yields of 98 to 100 % (J. MEMS, 2018-0257); loss of Q in leaking packages (Micromachines 14 (2023) 1956).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_pressure (B,) [1], zero where the package does not leak."""
    rise = np.maximum(p["ln_mean"] + p["ln_spread"] * site.normal("package")[0], 0.0)
    return Change(ln_pressure=np.where(site.uniform("package") < p["fraction"], rise, 0.0))


IRREGULARITY = Irregularity(
    name="lid_leak",
    stage="package",
    parameters=(
        IrregularityParameter("fraction", "1", 0.0, 1.0, "share of packages that leak"),
        IrregularityParameter(
            "ln_mean", "1", 0.0, 10.0, "mean of ln(pressure rise) at the time of the test", null=None
        ),
        IrregularityParameter("ln_spread", "1", 0.0, 5.0, "sd of ln(pressure rise)", null=None),
    ),
    source="J. MEMS 2018-0257 (seal yield); Micromachines 14 (2023) 1956 (loss of Q)",
    act=act,
    latex=r"\Delta \ln p = \max(n, 0) \ \text{with probability}\ q, \quad n \sim N(m, s)",
)
