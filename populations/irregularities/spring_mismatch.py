"""Stiffness mismatch between the springs of a device.

    d ln k_j = N(0, s) for each spring j
    four springs at right angles: e = (k2 + k4 - k1 - k3) / sum k, real, sd s / 2

s is ``die_pct``, and n_j a standard normal number of each spring.  Four springs at right angles that differ only in stiffness
have theta = 0 or 90 deg, and the sd of their anisotropy is s / 2.

Source: K_xx = sum k y^2, K_yy = sum k x^2, K_xy = -sum k x y (derivation); magnitude assumed.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_spring (J, B) [1], independent for each spring."""
    return Change(ln_spring=0.01 * p["die_pct"] * site.normal("die", len(site.device.spring_azimuth_deg)))


IRREGULARITY = Irregularity(
    name="spring_mismatch",
    stage="fabrication",
    parameters=(IrregularityParameter("die_pct", "% of k", 0.0, 10.0, "sd of the stiffness of a single spring"),),
    source="K = sum of springs; magnitude assumed",
    act=act,
    latex=r"\Delta \ln k_j = s\,n_j",
)
