"""Gas pressure under a tight lid.

    ln(p / p_lid) = s n

p is the pressure under the lid, s is ``spread`` and n a standard normal number of each package.

Source: spread of getter and outgassing (assumed); with 75 % of the losses due to gas it gives the reported spread of packaged Q.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..irregularity import Change, Irregularity, IrregularityParameter
from ..site import Site


def act(p: Mapping[str, float], site: Site) -> Change:
    """ln_pressure (B,) [1] of each package."""
    return Change(ln_pressure=p["spread"] * site.normal("package")[0])


IRREGULARITY = Irregularity(
    name="lid_pressure",
    stage="package",
    parameters=(IrregularityParameter("spread", "1", 0.0, 3.0, "sd of ln(pressure) from package to package"),),
    source="assumed; consistent with the reported packaged Q of 1800 +-200 at 200 mTorr",
    act=act,
    latex=r"\Delta \ln p = s\,n",
)
