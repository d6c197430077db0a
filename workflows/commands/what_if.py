"""gyroscreen report --limits."""

from __future__ import annotations

import re
from pathlib import Path

from reports.limits import load_limits


def what_if_report(run_id: str, results: Path, limits: Path, out: Path | None, json: bool) -> None:
    """Judge a stored run by other limits, write the page, and print what changes.

    Parameters
    ----------
    run_id, results : the run and its results folder.
    limits : file of the new limits.
    out : page to write; ``None``: report-limits-NAME.html in the folder of the run, NAME as of the limits.
    json : print one JSON object.
    """
    new = load_limits(limits)
    from reports.what_if.page import render_what_if
    from reports.words.what_if import what_if_lines

    from ..stored_page import stored_page
    from ..what_if.answer import answer
    from ..what_if.run import judged_run

    found = judged_run(results, run_id, new, limits.name)
    path = stored_page(render_what_if(found.content), results, run_id, page_name(limits), out)
    if json:
        import json as json_

        print(json_.dumps(answer(found, path)))
    else:
        print("\n".join([*what_if_lines(found.content), str(path)]))


def page_name(limits: Path) -> str:
    """Name of the page in the run's folder; it is never that of the run's own report."""
    return f"report-limits-{re.sub(r'[^A-Za-z0-9_-]+', '-', limits.stem)[:80] or 'new'}.html"
