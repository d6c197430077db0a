"""gyroscreen report --against."""

from __future__ import annotations

import json as json_
from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import GateError, printable_lines
from reports.words import trend as words

from ..stored_page import stored_page
from ..trend.answer import trend

#: The page of a trend in the folder of its run, beside report.html.
PAGE = "trend.html"


def against(
    run: str | None,
    results: Path,
    other: str,
    alarms: Sequence[str],
    without: Sequence[str],
    out: Path | None,
    json: bool,
) -> None:
    """See ``gyroscreen report --help``.

    Raises
    ------
    GateError : an alarm that the user set was raised.
    """
    content = trend(results, run, other, alarms, without)
    from reports.trend.page import render_trend  # it loads matplotlib

    path = stored_page(render_trend(content), results, content.run_id, PAGE, out)
    if json:
        print(json_.dumps(content.to_dict() | {"headline": words.headline(content), "page": str(path)}))
    else:
        print(printable_lines(words.terminal(content)))
        print(path)
    if content.negative:
        raise GateError(
            words.alarm_count(content.negative),
            allowed="a night in control, and values within the limits of [trend] and --alarm",
            next_step=f"see {path}",
        )
