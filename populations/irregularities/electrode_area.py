"""Area of each electrode and distance of its centroid from the centre (arm).

    K ~ A,   gain for rocking ~ K times the arm   =>   sense_imbalance, drive_imbalance, electrode_mismatch, softening

A_k is the area of electrode k, l_k its arm and K_k its gain.  s_A is ``die_pct``, s_l is ``arm_pct``, and the n are
standard normal numbers of each electrode.  Areas and arms determine
sense_imbalance, drive_imbalance, the electrode mismatch and the electrostatic softening.

Source: parallel-plate force and current eps A V / g^2; the sense gains of the paper's device differ by 7.4 %; magnitudes
assumed.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_area and ln_arm of D1, D2, S1, S2, both (4, B) [1]."""
    return Change(
        ln_area=0.01 * p["die_pct"] * site.normal("die", 4),
        ln_arm=0.01 * p["arm_pct"] * site.normal("die", 4, "arm"),
    )


IRREGULARITY = Irregularity(
    name="electrode_area",
    stage="fabrication",
    parameters=(
        IrregularityParameter("die_pct", "% of A", 0.0, 30.0, "sd of the area of a single electrode"),
        IrregularityParameter("arm_pct", "% of l", 0.0, 30.0, "sd of the arm of a single electrode"),
    ),
    source="parallel plates; magnitudes assumed",
    act=act,
    latex=r"\Delta \ln A_k = s_A\,n_{A, k}, \quad \Delta \ln l_k = s_l\,n_{l, k}, \quad K_k \propto A_k,"
    r" \quad \text{gain for rocking} \propto K_k\,l_k",
)
