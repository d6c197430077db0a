"""Offset of the post from the centre: adds an anisotropy of inertia, and couples rocking with up-down.

    d = lot + die, a vector;   I_xx += m_p y^2, I_yy += m_p x^2, I_xy -= m_p x y;   static moment m_p d -> updown_tilt

d_lot and d_die are vectors; their components are normal with the sds ``lot_um`` and ``die_um``.  m_p is the mass of the post
and I the inertia of rocking.  The static moment m_p d tilts the up-down mode.

Source: parallel-axis theorem and static moment (derivation in populations/assembly.py); placement errors assumed.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """post_offset_mm (B,) [mm], normal in x and in y."""
    offset_um = p["lot_um"] * site.complex_normal("lot") + p["die_um"] * site.complex_normal("die")
    return Change(post_offset_mm=1e-3 * offset_um)


IRREGULARITY = Irregularity(
    name="post_offset",
    stage="fabrication",
    parameters=(
        IrregularityParameter("lot_um", "um", 0.0, 200.0, "sd per component of the mean of a lot (jig)"),
        IrregularityParameter("die_um", "um", 0.0, 200.0, "sd per component from die to die"),
    ),
    source="parallel-axis theorem; magnitudes assumed",
    act=act,
    latex=r"d = d_\text{lot} + d_\text{die}, \quad I \to I + m_p"
    r" \begin{pmatrix} d_y^2 & -d_x d_y \\ -d_x d_y & d_x^2 \end{pmatrix}",
)
