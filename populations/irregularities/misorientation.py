"""Rotation of the mask relative to the crystal, and azimuth errors of the springs.

    1/E(a) = s11 - 2 (s11 - s12 - s44/2) cos^2 a sin^2 a,   a = crystal angle + phi_j + rotation
    d ln k_j = ln E(a) - ln E(a at rotation 0)
    phi_j -> phi_j + azimuth error   =>   e = -sum k_j exp(2 i phi_j) / sum k_j gains an imaginary part

E is the modulus of silicon along a spring, s_11, s_12 and s_44 are its compliances, alpha_j is the angle of spring j to the
crystal without an error, and rho is the rotation of the mask.  The azimuth of each spring has an error of its own, with the sd
``azimuth_mrad``: it turns the axes.

E has a period of 90 deg, so the rotation causes no split of four identical springs at right angles; azimuth errors rotate theta.

Source: Hopcroft, Nix, Kenny, J. MEMS 19 (2010) 229 (silicon compliances); azimuth errors assumed (0.3 um over 1 mm).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.arrays import FloatArray

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site

S11, S12, S44 = 7.68e-12, -2.14e-12, 12.6e-12  # 1/Pa


def ln_young(angle_rad: FloatArray) -> FloatArray:
    """ln(E / Pa) of silicon at an angle [rad] from <100> in the (100) plane, same shape."""
    half = 0.5 * np.sin(2.0 * angle_rad)
    result: FloatArray = -np.log(S11 - 2.0 * (S11 - S12 - S44 / 2.0) * half * half)
    return result


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_spring [1] from E, and azimuth_rad [rad], both (J, B)."""
    springs = len(site.device.spring_azimuth_deg)
    rotation = p["lot_deg"] * site.normal("lot")[0] + p["wafer_deg"] * site.normal("wafer")[0]
    nominal = np.deg2rad(site.device.crystal_angle_deg) + np.broadcast_to(
        site.spring_azimuth(), (springs, len(rotation))
    )
    return Change(
        ln_spring=ln_young(nominal + np.deg2rad(rotation)) - ln_young(nominal + 0.0),
        azimuth_rad=1e-3 * p["azimuth_mrad"] * site.normal("die", springs),
    )


IRREGULARITY = Irregularity(
    name="misorientation",
    stage="fabrication",
    parameters=(
        IrregularityParameter(
            "lot_deg", "deg", 0.0, 10.0, "sd of the angle between wafer flat and crystal, from lot to lot"
        ),
        IrregularityParameter(
            "wafer_deg", "deg", 0.0, 10.0, "sd of the angle between mask and wafer flat, from wafer to wafer"
        ),
        IrregularityParameter("azimuth_mrad", "mrad", 0.0, 100.0, "sd of the azimuth of a single spring"),
    ),
    source="Hopcroft et al., J. MEMS 19 (2010) 229; azimuth errors assumed",
    act=act,
    latex=r"\Delta \ln k_j = \ln \frac{E(\alpha_j + \rho)}{E(\alpha_j)}, \quad"
    r" \frac{1}{E(\alpha)}"
    r" = s_{11} - (2 s_{11} - 2 s_{12} - s_{44}) \cos^2 \alpha \, \sin^2 \alpha",
)
