"""Gap of each electrode: gains vary as 1/g^2, electrostatic softening as 1/g^3.

    ln g_k = lot + wafer + die_k,   K ~ A / g^2,   k_e = eps A V^2 / g^3

g_k is the gap of electrode k, A_k its area, K_k its gain and k_e its electrostatic spring at the voltage V.
n_lot, n_wafer and n_die are normal with the sds ``lot_pct``, ``wafer_pct`` and ``die_pct``.  Each
electrode has an n_die of its own.

Source: parallel plates (derivation); Sensors 12 (2012) 6857 reports a gap asymmetry of +-5 % for a 4 um gap.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_gap (4, B) [1] of D1, D2, S1, S2."""
    common = p["lot_pct"] * site.normal("lot")[0] + p["wafer_pct"] * site.normal("wafer")[0]
    return Change(ln_gap=0.01 * (common + p["die_pct"] * site.normal("die", 4)))


IRREGULARITY = Irregularity(
    name="electrode_gap",
    stage="fabrication",
    parameters=(
        IrregularityParameter("lot_pct", "% of g", 0.0, 30.0, "sd of the mean gap of a lot"),
        IrregularityParameter("wafer_pct", "% of g", 0.0, 30.0, "sd of the mean gap of a wafer within a lot"),
        IrregularityParameter("die_pct", "% of g", 0.0, 30.0, "sd of the gap of a single electrode"),
    ),
    source="parallel plates; Sensors 12 (2012) 6857; magnitudes assumed",
    act=act,
    latex=r"\Delta \ln g_k = n_\text{lot} + n_\text{wafer} + n_{\text{die}, k}, \quad K_k \propto \frac{A_k}{g_k^2},"
    r" \quad k_e = \frac{\varepsilon A_k V^2}{g_k^3}",
)
