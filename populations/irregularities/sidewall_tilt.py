"""Tilt of etched sidewalls towards the edge of the wafer, where the plasma sheath bends.

    T = T_edge rho along the radius at azimuth phi,   e = a T^2 exp(2 i phi)

rho and phi are the polar coordinates of the die, rho = 1 at the edge of the wafer.  T_edge is ``edge_deg`` and a is
``anisotropy_pct_per_deg2``.  The tilt couples in-plane and out-of-plane bending in second order, so e varies as T^2.

Source: radial tilt of 0 at the centre and 0.3 to 1 deg at the edge (assumed); T^2 exp(2 i phi) from the product of inertia of a
tilted beam (derivation).
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site
from ..symmetric import as_complex


def act(p: Mapping[str, float], site: Site) -> Change:
    """anisotropy (B,) [1] = a T^2 exp(2 i phi), where rho^2 exp(2 i phi) = (x + i y)^2."""
    radius = site.wafer.diameter_mm / 2.0
    x, y = p["edge_deg"] * site.places.x_mm / radius, p["edge_deg"] * site.places.y_mm / radius
    gain = 0.01 * p["anisotropy_pct_per_deg2"]
    return Change(anisotropy=as_complex(gain * (x * x - y * y), gain * 2.0 * x * y))


IRREGULARITY = Irregularity(
    name="sidewall_tilt",
    stage="fabrication",
    parameters=(
        IrregularityParameter("edge_deg", "deg", 0.0, 5.0, "tilt of the sidewalls at the edge of the wafer"),
        IrregularityParameter(
            "anisotropy_pct_per_deg2", "%/deg^2", -10.0, 10.0, "a, anisotropy per square of the tilt", null=None
        ),
    ),
    source="radial tilt of deep etching (magnitude assumed); T^2 law (derivation)",
    act=act,
    latex=r"e = a\,T^2 e^{2 i \varphi}, \quad T = \rho\,T_\text{edge}",
)
