"""gyroscreen query, report, verify."""

from __future__ import annotations

import io
import json as json_
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import IncompleteError, IntegrityError, UsageError, printable, printable_lines
from pipeline.store.folders import PREFIX
from pipeline.store.manifest import Manifest
from pipeline.store.query import answer, write_table
from pipeline.store.read import LATEST, find_run, list_runs
from pipeline.store.verify import verify as verify_results
from reports.html.drawing_process import drawing_beside
from reports.run import FIGURES

if TYPE_CHECKING:
    from ..screening.repair import RepairStep

FORMATS = ("table", "csv", "json", "parquet")
#: Rows of a table for the eye, unless the user asks for more.
_SHOWN = 1000


def query(sql: str, results: Path, format: str | None, run: str, rows: str | None, out: Path | None) -> None:
    """See ``gyroscreen query --help``."""
    chosen = format or (None if out is None else out.suffix.removeprefix(".")) or "table"
    if chosen not in FORMATS:
        raise UsageError(
            "unknown --format" if format or out is None else "the name of --out has the suffix of no format",
            value=chosen,
            allowed=", ".join(FORMATS),
            next_step="choose one of these with --format",
        )
    most = _most(rows, _SHOWN if chosen == "table" and out is None else None)
    found = answer(sql, results, run=run, rows=most)
    _name_run(list_runs(results), run)
    if out is None and chosen == "csv" and sys.stdout.isatty():
        shown = io.BytesIO()
        write_table(found.table, chosen, shown)
        # A terminal would obey control characters of ids; a file or a pipe receives them as they are.
        print(printable_lines(shown.getvalue().decode()), end="")
    else:
        write_table(found.table, chosen, sys.stdout.buffer if out is None else out)
    sys.stdout.flush()
    left = found.rows - found.table.num_rows
    if left:
        print(
            f"{left} of {found.rows} rows were left out; all of them: --rows all, or to a file: --out FILE.csv",
            file=sys.stderr,
        )
    if out is not None:
        print(out)


def _most(rows: str | None, default: int | None) -> int | None:
    """The number of rows that --rows asks for; ``None``: all."""
    if rows is None:
        return default
    if rows == "all":
        return None
    if not rows.isascii() or not rows.isdecimal() or len(rows) > 15:
        raise UsageError(
            "--rows is no number of rows", value=rows, allowed="0 or more, or 'all'", next_step="correct --rows"
        )
    return int(rows)


def _name_run(runs: Sequence[Manifest], run: str) -> None:
    """Say which run was queried where the folder has several and the user named none."""
    if run == LATEST and len(runs) > 1:
        print(f"run {runs[-1].run_id}, the latest of {len(runs)}; others: --run ID, all: --run all", file=sys.stderr)


def report(run: str | None, results: Path, out: Path | None, limits: Path | None = None, json: bool = False) -> None:
    """See ``gyroscreen report --help``."""
    chosen = find_run(results, run).name.removeprefix(PREFIX)
    if limits is not None:
        from .what_if import what_if_report

        what_if_report(chosen, results, limits, out, json)
        return
    # It loads while the rest is imported.
    with drawing_beside(FIGURES) as beside:
        from ..screening.outcome import rendered_report, store_report, write_report
        from ..stored_page import written_page

        if out is None:
            path = write_report(results, chosen, beside)
        else:
            page = rendered_report(results, chosen, beside)
            # The results may be read-only; the user asks for a page elsewhere.
            with suppress(IncompleteError):
                store_report(results, chosen, page)
            path = written_page(page, out)
    if json:
        from .report_answer import report_answer

        print(json_.dumps(report_answer(results, chosen, path)))
    else:
        print(path)


def verify(results: Path, json: bool, repair: bool) -> None:
    """See ``gyroscreen verify --help``."""
    found = verify_results(results)
    steps: tuple[RepairStep, ...] = ()
    if repair and not found.ok:
        from ..screening.repair import repair as repaired  # imports the physics, which a check does without

        steps = repaired(results, quiet=json)
        found = verify_results(results)
    fatal = [finding for finding in found.findings if finding.fatal]
    if json:
        done = {"repair": [asdict(step) for step in steps]} if repair else {}
        print(json_.dumps({"ok": found.ok, **asdict(found), **done}))
    else:
        for line in (*steps, *found.findings):
            print(printable(str(line)))
        verdict = "unchanged since it was written" if found.ok else f"damaged, {len(fatal)} findings"
        print(f"{verdict}: {found.runs} runs, {found.files} files, {found.devices} devices, {found.draws} draws")
    if fatal:
        raise IntegrityError(
            "the results have changed since they were written",
            value=fatal[0].file,
            next_step="see the findings above; restore the named files from a copy"
            if repair
            else "gyroscreen verify --repair computes damaged tables again",
        )
