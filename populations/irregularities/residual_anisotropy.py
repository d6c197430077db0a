"""Stiffness anisotropy from other causes, such as film stress, mass differences and moments at the spring ends.

    e += s (r_lot n_lot + r_wafer n_wafer + n_die),   n complex normals without preferred axis

s is ``die_pct``, r_lot is ``lot_ratio`` and r_wafer is ``wafer_ratio``.  The n are complex normals: no axis is preferred.

Source: an assumption, to be varied.  Reported splits before trimming are 1.9 Hz (the paper) and 9 to 26 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """anisotropy (B,) [1]: sum of lot, wafer and die, in a fixed ratio."""
    levels = p["lot_ratio"] * site.complex_normal("lot") + p["wafer_ratio"] * site.complex_normal("wafer")
    return Change(anisotropy=0.01 * p["die_pct"] * (levels + site.complex_normal("die")))


IRREGULARITY = Irregularity(
    name="residual_anisotropy",
    stage="fabrication",
    parameters=(
        IrregularityParameter(
            "die_pct", "%", 0.0, 10.0, "sd per component from die to die", assumption="residual_anisotropy"
        ),
        IrregularityParameter("lot_ratio", "1", 0.0, 10.0, "sd from lot to lot, over die_pct"),
        IrregularityParameter("wafer_ratio", "1", 0.0, 10.0, "sd from wafer to wafer, over die_pct"),
    ),
    source="assumption; consistent with the split before trimming that the paper reports",
    act=act,
    latex=r"e = s \left( r_\text{lot}\,n_\text{lot} + r_\text{wafer}\,n_\text{wafer} + n_\text{die} \right)",
)
