"""Stiffness anisotropy that no single cause accounts for: film stress, leaf mass, moments at the spring ends.

    e += s (r_lot n_lot + r_wafer n_wafer + n_die),   n complex normals (2-theta: no preferred axis)

Source: none found; an assumption, to be swept.  Splits before trimming of 1.9 Hz (the paper) and of 9 to 26
Hz are reported.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """anisotropy from three levels in a fixed ratio."""
    levels = p["lot_ratio"] * site.complex_normal("lot") + p["wafer_ratio"] * site.complex_normal("wafer")
    return Change(anisotropy=0.01 * p["die_pct"] * (levels + site.complex_normal("die")))


IRREGULARITY = Irregularity(
    name="residual_anisotropy",
    stage="fabrication",
    parameters=(
        IrregularityParameter(
            "die_pct", "%", 0.0, 10.0, "sd per component from die to die", assumption="residual_anisotropy"
        ),
        IrregularityParameter("lot_ratio", "1", 0.0, 10.0, "sd of the lots over die_pct"),
        IrregularityParameter("wafer_ratio", "1", 0.0, 10.0, "sd of the wafers over die_pct"),
    ),
    source="assumption; splits before trimming as reported by the paper",
    act=act,
)
