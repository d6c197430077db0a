"""gyroscreen benchmark silverbox."""

from __future__ import annotations

import json as json_
from pathlib import Path

from pipeline.errors import UsageError
from pipeline.experiment.instrument import HOLDS
from pipeline.plain import plain

from ..studies.silverbox import refine_silverbox, table


def silverbox(data: Path, hold: str, json: bool) -> None:
    """See ``gyroscreen benchmark silverbox --help``."""
    if hold not in HOLDS:
        raise UsageError("no such hold", value=hold, allowed=", ".join(HOLDS))
    found = refine_silverbox(data, hold)
    said = found.to_dict()
    if json:
        told = {key: said[key] for key in ("verdict", "effects", "classes", "refused", "hints", "noise")}
        print(json_.dumps(plain({"hold": hold, "rungs": table(found), **told})))
        return
    print(found)
