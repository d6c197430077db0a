"""gyroscreen benchmark undetected."""

from __future__ import annotations

import json as json_
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..studies.coverage import COVERED, Share
from ..studies.hidden.study import rows_in
from ..studies.undetected import by_effect, effects_of, figures, run_study
from .benchmark import follow, show


def undetected(effect: str, devices: int, seed: int, workers: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark undetected --help``."""
    effects = effects_of(effect)
    follow(run_study(effects, devices, seed, out, workers), "devices")
    rows = [row for row in rows_in(out, effects, seed) if row["number"] < devices]
    found, each = figures(rows), by_effect(rows)
    if json:
        print(json_.dumps({"figures": _plain(found), "effects": {name: _plain(one) for name, one in each.items()}}))
        return
    show(found, False)
    labels = tuple(COVERED.values())
    head = "".join(f"{label:>22s}" for label in labels)
    print(f"\n{'among the ok, inside the widened interval':28s}{head}   largest error, sd")
    for name, one in each.items():
        shares = "".join(f"{_short(one[label]):>22s}" for label in labels)
        print(f"{name:26s} {one['ok']:4d} of {one['devices']:4d}{shares}   {one['largest error, sd']:.1f}")


def _short(share: Share) -> str:
    if not share.total:
        return "none"
    low, high = share.interval
    return f"{100 * share.count / share.total:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def _plain(found: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: {"count": v.count, "total": v.total, "interval": list(v.interval)} if isinstance(v, Share) else v
        for name, v in found.items()
    }
