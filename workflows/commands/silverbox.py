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
        raise UsageError("unknown --hold", value=hold, allowed=", ".join(HOLDS), next_step="choose one of these")
    found = refine_silverbox(data, hold)
    if json:
        answer = found.to_dict()
        kept = {key: answer[key] for key in ("verdict", "effects", "classes", "refused", "hints", "noise")}
        print(json_.dumps(plain({"hold": hold, "rungs": table(found), **kept})))
        return
    print(found)
