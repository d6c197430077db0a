"""What of a night can be charted and limited: its yield, the means of its quantities, and what stands for theta.

theta is an axis modulo 180 deg without a mean of its own; the two components of the anisotropy vector, split cos 2 theta and
split sin 2 theta [Hz], stand for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pipeline.errors import ConfigError
from pipeline.quantities import QUANTITIES
from pipeline.toml_files import check_known

from ..limits import BoundsTable, Limit

YIELD = "yield"
#: Components of the anisotropy vector [Hz], which stand for theta.
COMPONENTS = ("split_cos2theta_hz", "split_sin2theta_hz")
#: Name -> unit.
CHARTED: Mapping[str, str] = {
    YIELD: "1",
    **{quantity.name: quantity.unit for quantity in QUANTITIES if not quantity.axis},
    **dict.fromkeys(COMPONENTS, "Hz"),
}


def night_limits(bounds: Mapping[str, BoundsTable], where: str) -> tuple[Limit, ...]:
    """The limits on yield and means of a night; ``where`` names their file in messages.

    Raises
    ------
    ConfigError : an unknown quantity; a limit that is empty or crossed.
    """
    return tuple(_limit(name, table, where) for name, table in bounds.items())


def _limit(name: str, bounds: BoundsTable, where: str) -> Limit:
    check_known(name, CHARTED, f"{where}: trend.limits", "quantity")
    low = -math.inf if bounds.min is None else bounds.min
    high = math.inf if bounds.max is None else bounds.max
    if bounds == BoundsTable() or low > high:
        raise ConfigError(
            f"{where}: trend.limits.{name} limits nothing, or its limits are crossed",
            value={"min": bounds.min, "max": bounds.max},
            allowed="min, max or both, min <= max",
            next_step=f"correct trend.limits.{name}",
        )
    return Limit(name, low, high)
