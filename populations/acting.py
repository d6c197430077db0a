"""The changes of an irregularity, with faults of a user's file named by file, line and statement."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.errors import ConfigError
from pipeline.user_code import fault, fault_at, line_of_result

from . import irregularities
from .changes import check_change
from .irregularity import Change, Irregularity
from .site import Site

_GUIDE = "correct this line; see docs/how-to/add-an-irregularity.md"


def acted(irregularity: Irregularity, values: Mapping[str, float], site: Site) -> Change:
    """``irregularity.act(values, site)``, checked.

    Raises
    ------
    ConfigError : ``act`` of a user's file fails, or gives no ``Change`` with the declared shapes and types; with file and line.
    """
    act, file = irregularity.act, irregularity.act.__code__.co_filename
    if Path(file).parent == Path(irregularities.__path__[0]):
        return act(values, site)
    what = f"the irregularity {irregularity.name!r} fails"
    try:
        with np.errstate(all="ignore"):
            found = act(values, site)
    except Exception as error:
        raise fault(what, error, file, _GUIDE) from error
    line = line_of_result(act, file)
    if type(found) is not Change:  # what the declared type says need not hold
        kind = "nothing" if found is None else f"a {type(found).__name__}"
        raise fault_at(what, f"act gives {kind}", file, line, _GUIDE, "a populations.irregularity.Change")
    try:
        check_change(irregularity.name, found, len(site.index), len(site.device.spring_azimuth_deg))
    except ConfigError as error:
        raise fault_at(what, f"{error.what}: {error.value}", file, line, _GUIDE, error.allowed) from error
    return found
