"""Damping that depends on the direction of rocking; its axes are independent of the stiffness axes.

    C = c0 (1 + [[Re d, Im d], [Im d, -Re d]]),   d = s n, n a complex normal, |d| limited to ``limit``

s is ``die`` and n a complex normal.  A larger d is shortened to ``limit``, on the same axis.  d determines zeta1, zeta2 and c12.

Source: the paper's rocking dampings differ by a factor 2.0 (3.167e-4, 1.586e-4); the spread is an assumption, to be varied.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """damping_anisotropy (B,) [1]; a larger modulus is reduced to the limit, on the same axis."""
    d = p["die"] * site.complex_normal("die")
    return Change(damping_anisotropy=d / np.maximum(np.hypot(d.real, d.imag) / p["limit"], 1.0))


IRREGULARITY = Irregularity(
    name="damping_anisotropy",
    stage="fabrication",
    parameters=(
        IrregularityParameter(
            "die", "1", 0.0, 2.0, "sd per component from die to die", assumption="damping_anisotropy"
        ),
        IrregularityParameter(
            "limit", "1", 0.01, 0.99, "largest |d|; below 1 both damping ratios are positive", null=0.8
        ),
    ),
    source="the paper, eq. (15); magnitude assumed",
    act=act,
    latex=r"C = c_0 \left( 1 + \begin{pmatrix} \text{Re}\,d & \text{Im}\,d \\ \text{Im}\,d & -\text{Re}\,d \end{pmatrix} \right),"
    r" \quad d = s\,n, \quad |d| \le \text{limit}",
)
