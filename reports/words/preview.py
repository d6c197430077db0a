"""What a run configuration implies, as lines of text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .limits import origin_words
from .numbers import number
from .quantities import UNITS, label, limit_words, percent, percent_range

if TYPE_CHECKING:
    from ..limits import Limits
    from ..limits_origin import LimitsOrigin
    from ..preview import Preview
    from ..yields import Interval


#: Said of a configuration with [sampling], which `run` and `rare` may share.
NOT_SAMPLED = "[sampling] is for `gyroscreen rare`: this run draws its devices as the population makes them"


def preview_lines(preview: Preview | None, limits: Limits, origin: LimitsOrigin) -> list[str]:
    """Limits with their origin, the nominal device, the drawn quantities and the expected yield."""
    rule = f"pass at {limits.rule.pass_at:g}, fail at {limits.rule.fail_at:g}"
    lines = [f"limits: {origin_words(origin)}; rule {limits.rule.name}: {rule}"]
    if preview is None:
        return [*lines, *(f"  {one.quantity}: {limit_words(one)}" for one in limits.limits)]
    nominal = preview.nominal
    lines.append(
        f"nominal device: rocking {number(nominal['f1_hz'], 6)} and {number(nominal['f2_hz'], 6)} Hz, "
        f"up-down {number(nominal['f3_hz'], 6)} Hz, Q {number(nominal['quality1'])}, {number(nominal['quality2'])} "
        f"and {number(nominal['quality3'])}"
    )
    lots = "each of a lot of its own" if preview.lots == preview.drawn else f"of {preview.lots} lots"
    lines.append(f"quick draw: {preview.drawn} devices, {lots}; nothing is simulated or identified")
    bounds = {one.quantity: limit_words(one) for one in limits.limits}
    rows: list[tuple[str, ...]] = [("quantity", "5 %", "50 %", "95 %", "limit", "beyond it (95 %)")]
    for one in preview.quantities:
        unit = UNITS.get(one.name, "")
        beyond = "" if one.loss is None else _with_interval(one.share, one.loss)
        name = f"{label(one.name)}{f', {unit}' if unit else ''}"
        rows.append(
            (
                name,
                *("–" if math.isnan(value) else number(value) for value in one.quantiles),
                bounds.get(one.name, ""),
                beyond,
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines += ["  " + "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths)).rstrip() for row in rows]
    lines.append(
        f"expected yield: {_with_interval(preview.share, preview.interval)}: devices that truly conform to all limits, over many "
        "lots; undecided devices do not pass, and the few lots of one run scatter about it"
    )
    return [line.replace("\u00a0", " ") for line in lines]


def _with_interval(share: float, interval: Interval) -> str:
    return f"{percent(share)} ({percent_range(interval.low, interval.high)})"
