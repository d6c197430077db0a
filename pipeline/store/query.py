"""SQL on the results: DuckDB over the committed files, in a locked and limited process of its own.

Views ``devices``, ``posterior`` and ``irregularities`` (of the latest run, of a named one or of all, with ``run_id``),
``runs`` (all) and ``columns``.  The files come from the manifests, never from a glob; whatever the statement makes DuckDB open
is checked against its SHA-256 as it is opened, so no answer is computed from damaged files (pipeline.sql.verified).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from ..errors import GyroscreenError, UsageError
from ..sql.client import QueryProcess, SqlAnswer
from ..sql.request import Question, file_schema
from .folders import PREFIX
from .manifest import Kind, Manifest
from .output import FORMATS, write_table
from .read import LATEST, find_run, list_runs
from .views import columns_view, runs_view, view_schema

__all__ = ["FORMATS", "answer", "query", "write_table"]

MAX_ANSWER_BYTES = 1 << 30
_TRIES = 20
ALL = "all"
_VIEWS: tuple[Kind, ...] = ("devices", "posterior", "irregularities")
_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_UNITS |= {"KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}


def query(
    sql: str, results: Path, *, run: str = LATEST, timeout_s: float = 60.0, memory_limit: str = "2GB"
) -> pa.Table:
    """SqlAnswer one SELECT on a run of a results folder, or on all of them.

    Parameters
    ----------
    sql : one statement of DuckDB's dialect that only reads (SELECT, WITH, FROM, DESCRIBE, SUMMARIZE).
    results : folder of all runs.
    run : id of the run that these three views contain, "latest" or "all".
    timeout_s : longest time the statement may take [s].
    memory_limit : most memory that the process of the query may take; idle it takes 0.1 GB.

    Returns
    -------
    The answer.  Columns of the results keep their unit and meaning in the field metadata; repeated names
    get a number.

    Raises
    ------
    UsageError : no runs or no such run; not one SELECT; SQL that DuckDB rejects or that exceeds the memory limit; a
        result above 1 GiB; the time limit is exceeded.
    IntegrityError : results differ from what was committed.
    """
    return answer(sql, results, run=run, timeout_s=timeout_s, memory_limit=memory_limit).table


def answer(
    sql: str,
    results: Path,
    *,
    run: str = LATEST,
    timeout_s: float = 60.0,
    memory_limit: str = "2GB",
    rows: int | None = None,
) -> SqlAnswer:
    """As :func:`query`, with the number of all rows and of them the first ``rows`` (``None``: all)."""
    if not timeout_s > 0.0:
        raise UsageError("the timeout is not a positive time", value=timeout_s, allowed="more than 0 s")
    request = Question(sql, _bytes_of(memory_limit), MAX_ANSWER_BYTES, rows)
    find_run(results, None if run == ALL else run)
    for _ in range(_TRIES):
        with QueryProcess() as process:
            runs = list_runs(results)
            try:
                found = process.ask(request, _tables(results, runs, run), timeout_s)
            except GyroscreenError:
                if not _replaced(results, runs):
                    raise
                continue
        return SqlAnswer(_with_units(found.table), found.rows)
    raise UsageError(
        "the tables of the run are replaced again and again", value=str(results), next_step="repeat the query later"
    )


def _bytes_of(memory_limit: str) -> int:
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?I?B)\s*", memory_limit.upper())
    size = int(float(found[1]) * _UNITS[found[2]]) if found and found[2] in _UNITS else 0
    if not 0 < size < 2**60:
        raise UsageError("not a memory limit", value=memory_limit, allowed="for instance 2GB")
    return size


def _replaced(results: Path, runs: Sequence[Manifest]) -> bool:
    """Whether a writer has replaced tables of ``runs`` since their manifests were read; further blocks do not count."""
    now = {(run.run_id, file) for run in list_runs(results) for file in run.files}
    return any((run.run_id, file) not in now for run in runs for file in run.files if file.kind in _VIEWS)


def chosen_runs(runs: Sequence[Manifest], run: str) -> tuple[Manifest, ...]:
    """The runs, oldest first, that ``run`` names: an id, "latest" or "all"."""
    if run == ALL:
        return tuple(runs)
    return tuple(runs[-1:] if run == LATEST else (one for one in runs if one.run_id == run))


def _tables(results: Path, runs: Sequence[Manifest], run: str) -> list[pa.Table]:
    """What the process reads: the files with their hashes, the schemas of the tables, the other views."""
    rows = [
        (kind, m.run_id, str((results / f"{PREFIX}{m.run_id}" / entry.name).resolve()), [entry.sha256])
        for kind in _VIEWS
        for m in chosen_runs(runs, run)
        for entry in m.of_kind(kind)
    ]
    columns = list(zip(*rows)) or [()] * 4
    files = pa.table([pa.array(values, field.type) for values, field in zip(columns, file_schema())], file_schema())
    schemas = [view_schema(kind).empty_table() for kind in _VIEWS]
    return [files, *schemas, runs_view(runs), columns_view()]


def _with_units(table: pa.Table) -> pa.Table:
    """Number repeated names; restore the unit and meaning of results columns."""
    registered = {field.name: field for kind in reversed(_VIEWS) for field in view_schema(kind)}
    seen: Counter[str] = Counter()
    fields = []
    for field in table.schema:
        known = registered.get(field.name)
        named = field.with_metadata(known.metadata) if known is not None and known.type == field.type else field
        fields.append(named if not seen[field.name] else named.with_name(f"{field.name}_{seen[field.name]}"))
        seen[field.name] += 1
    return pa.table(table.columns, schema=pa.schema(fields))
