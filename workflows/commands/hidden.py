"""gyroscreen benchmark hidden-effects."""

from __future__ import annotations

import json as json_
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..studies.coverage import Share
from ..studies.hidden.confusion import answer, confusion, figures, found_as, is_unexpected, power
from ..studies.hidden.draw import hide
from ..studies.hidden.study import examine, rows_in, run_study, study_plan
from .benchmark import follow


def hidden_effects(
    kind: str, campaigns: int | None, only: int | None, seed: int, workers: int, out: Path, json: bool
) -> None:
    """See ``gyroscreen benchmark hidden-effects --help``."""
    plan = study_plan(kind, campaigns, seed, only)
    if only is not None:
        row = examine(hide(kind, only, seed))
        print(json_.dumps(row, indent=None if json else 2, default=float))
        return
    follow(run_study(plan, out, workers), "campaigns")
    rows = [r for r in rows_in(out, tuple(plan.numbers), seed) if r["number"] in plan.numbers[r["kind"]]]
    print(json_.dumps(_plain(rows)) if json else "\n".join(lines(rows)))


def _plain(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    found = {k: _share(v) if isinstance(v, Share) else v for k, v in figures(rows).items()}
    matrices = {step: confusion(rows, step) for step in ("diagnose", "refine")}
    curve = [{"snr": [low, high], **counts} for low, high, counts in power(rows)]
    return {
        "figures": found,
        "confusion": matrices,
        "power": curve,
        "odd": [_key(row) for row in rows if is_unexpected(row)],
    }


def _share(share: Share) -> dict[str, Any]:
    return {"count": share.count, "total": share.total, "interval": list(share.interval)}


def _key(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in ("kind", "number", "seed", "hidden", "snr", "failed")}


def lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Error rates, power curve, confusion matrices and every unexpected answer, as lines of text."""
    out = [f"{name:68s} {v:.2f}" if isinstance(v, float) else f"{name:68s} {v}" for name, v in figures(rows).items()]
    out += ["", "One effect hidden, diagnose, by SNR"]
    for low, high, counts in power(rows):
        total = sum(counts.values())
        if total:
            right = counts.get("right", 0)
            rest = ", ".join(f"{n} {name}" for name, n in counts.items() if name != "right")
            out.append(f"  {low:6.1f} to {high:6.1f}   right {Share(right, total)}" + (f"; {rest}" if rest else ""))
    for step in ("diagnose", "refine"):
        out += ["", f"Hidden -> found, {step}"]
        for hidden, found in confusion(rows, step).items():
            out.append(f"  {hidden:54s} {', '.join(f'{name} {n}' for name, n in found.items())}")
    unexpected = [row for row in rows if is_unexpected(row)]
    repeat = "Unexpected answers (repeat one with --kind KIND --only NUMBER --seed SEED)"
    out += ["", repeat if unexpected else "No unexpected answers."]
    for row in unexpected:
        snr = ", ".join(f"{value:.1f}" for value in row["snr"])
        steps = [step for step in ("diagnose", "refine") if row[step]]
        answers = "; ".join(f"{step} {answer(row, step)}: {found_as(row, step)}" for step in steps)
        hidden = " + ".join(row["hidden"]) or "nothing"
        result = row["failed"] or answers
        out.append(f"  {row['kind']} {row['number']} seed {row['seed']}  {hidden} (SNR {snr})  {result}")
    return out
