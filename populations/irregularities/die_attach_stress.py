"""In-plane stress of the die attach: shifts the frequencies, changes the split and rotates the axes.

    f_i = f0 + h sigma_i   =>   e = h ((sigma_x - sigma_y) + 2 i sigma_xy) / f0,   d ln k = h (sigma_x + sigma_y) / f0

h is ``hz_per_mpa`` and f_0 the rocking frequency.  sigma_x - sigma_y and 2 sigma_xy are normal with the same sd s =
``difference_mpa``, so there is no preferred axis.  (sigma_x + sigma_y)/2 is normal;
its mean and sd are given as ratios to s, so that varying s varies the whole stress.

Source: h = 4.8 Hz/MPa for springs of 1 mm x 20 um at 535 Hz (derivation: stress stiffening of a fixed-guided beam); 0.1 to
1 MPa for soft, 5 to 50 MPa for rigid die attach (assumed).
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """anisotropy and ln_stiffness, both (B,) [1]."""
    per_mpa = p["hz_per_mpa"] / site.device.rocking_hz
    mean = p["difference_mpa"] * (p["mean_ratio"] + p["mean_spread_ratio"] * site.normal("package", label="mean")[0])
    return Change(
        anisotropy=per_mpa * p["difference_mpa"] * site.complex_normal("package"),
        ln_stiffness=2.0 * per_mpa * mean,
    )


IRREGULARITY = Irregularity(
    name="die_attach_stress",
    stage="package",
    parameters=(
        IrregularityParameter(
            "difference_mpa",
            "MPa",
            0.0,
            100.0,
            "sd of sigma_x - sigma_y and of 2 sigma_xy",
            assumption="package_stress",
        ),
        IrregularityParameter("mean_ratio", "1", -100.0, 100.0, "mean of (sigma_x + sigma_y)/2 over difference_mpa"),
        IrregularityParameter("mean_spread_ratio", "1", 0.0, 100.0, "sd of (sigma_x + sigma_y)/2 over difference_mpa"),
        IrregularityParameter(
            "hz_per_mpa", "Hz/MPa", 0.0, 1000.0, "h, frequency shift of a rocking mode per stress along it", null=None
        ),
    ),
    source="stress stiffening (derivation); stresses assumed",
    act=act,
    latex=r"e = \frac{h}{f_0} \left( \sigma_x - \sigma_y + 2 i \sigma_{xy} \right), \quad"
    r" \Delta \ln k = \frac{h}{f_0} \left( \sigma_x + \sigma_y \right)",
)
