"""Width of the springs (lithography and etch bias): shifts all modes by the same ratio, a third of that of the thickness.

    k = E w t^3 / L^3   =>   d ln k = ln(1 + dw/w)

E is Young's modulus of the spring, w its width, t its thickness and L its length.  The deviation dw has a mean of each lot and
wafer, a radial bow b, a wedge, a smooth random field N and a value of each die.  rho, x and y are in wafer radii.

Source: fixed-guided beam, out of plane (derivation); magnitudes assumed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..across_wafer import LATEX, across_wafer, across_wafer_parameters
from ..irregularity import Change, Irregularity
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_spring (J, B) [1] = ln(1 + dw/w)."""
    return Change(ln_spring=np.log1p(across_wafer(p, "um", site) / site.device.spring_width_um))


IRREGULARITY = Irregularity(
    name="spring_width",
    stage="fabrication",
    parameters=across_wafer_parameters("um", "um", 5.0),
    source="k = E w t^3 / L^3; magnitudes assumed",
    act=act,
    latex=r"\begin{align*} \Delta \ln k_j &= \ln (1 + \Delta w / w), \quad k_j = \frac{E\,w\,t^3}{L^3} \\ \Delta w &= "
    + LATEX
    + r" \end{align*}",
)
