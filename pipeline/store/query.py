"""SQL on the results: DuckDB over the committed files, locked.

Views ``devices`` and ``posterior`` (of the latest run, of a named one or of all, with ``run_id``), ``runs`` (all) and
``columns``.  The files come
from the manifests, never from a glob; their SHA-256 is checked before the first row is read (those of
``posterior`` when the statement names it), the page checksums while reading, so no answer is computed
from damaged files.  The connection has no access to other files, the network or Python variables, its
settings are locked, and it accepts exactly one SELECT.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import duckdb
import pyarrow as pa
import pyarrow.dataset as ds
from pyarrow.fs import LocalFileSystem

from ..errors import GyroscreenError, IntegrityError, UsageError
from .manifest import Kind, Manifest
from .output import FORMATS, write_table
from .read import PREFIX, find_run, list_runs, read_file
from .views import columns_view, runs_view, view_schema

__all__ = ["FORMATS", "query", "write_table"]

MAX_ANSWER_BYTES = 1 << 30
_TRIES = 20
LATEST, ALL = "latest", "all"
_LOCKS = (
    "python_enable_replacements = false",
    "autoinstall_known_extensions = false",
    "autoload_known_extensions = false",
    "allow_community_extensions = false",
    "enable_external_access = false",
)
_COLUMNS_QUERY = "`SELECT name, unit, meaning FROM columns` lists all columns"


def query(
    sql: str, results: Path, *, run: str = LATEST, timeout_s: float = 60.0, memory_limit: str = "2GB"
) -> pa.Table:
    """Answer one SELECT on a run of a results folder, or on all of them.

    Parameters
    ----------
    sql : one statement of DuckDB's dialect that only reads (SELECT, WITH, FROM, DESCRIBE, SUMMARIZE).
    results : folder of all runs.
    run : id of the run that ``devices`` and ``posterior`` contain, "latest" or "all".
    timeout_s : longest time the statement may take [s].
    memory_limit : most memory that DuckDB may take, as DuckDB writes it.

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
    if not timeout_s > 0.0:
        raise UsageError("the timeout is not a positive time", value=timeout_s, allowed="more than 0 s")
    find_run(results, None if run in (LATEST, ALL) else run)
    for _ in range(_TRIES):
        runs = list_runs(results)
        try:
            answer = _answered(sql, results, runs, run, timeout_s, memory_limit)
        except GyroscreenError:
            if not _replaced(results, runs):
                raise
            continue
        if not _replaced(results, runs):
            return answer
    return _answered(sql, results, list_runs(results), run, timeout_s, memory_limit)


def _replaced(results: Path, runs: Sequence[Manifest]) -> bool:
    """Whether a writer has replaced tables of ``runs`` since their manifests were read; further blocks do not count."""
    now = {(run.run_id, file) for run in list_runs(results) for file in run.files}
    return any((run.run_id, file) not in now for run in runs for file in run.files if file.kind != "page")


def _answered(
    sql: str, results: Path, runs: Sequence[Manifest], run: str, timeout_s: float, memory_limit: str
) -> pa.Table:
    manifests = chosen_runs(runs, run)
    _check_files(results, manifests, "devices")
    if "posterior" in sql.lower():
        _check_files(results, manifests, "posterior")
    with _connection(memory_limit) as connection:
        connection.register("devices", _dataset(results, manifests, "devices"))
        connection.register("posterior", _dataset(results, manifests, "posterior"))
        connection.register("runs", runs_view(runs))
        connection.register("columns", columns_view())
        connection.execute("SET lock_configuration = true")
        return _with_units(_answer(connection, _one_select(connection, sql), sql, timeout_s))


def chosen_runs(runs: Sequence[Manifest], run: str) -> tuple[Manifest, ...]:
    """The runs, oldest first, that ``run`` names: an id, "latest" or "all"."""
    if run == ALL:
        return tuple(runs)
    return tuple(runs[-1:] if run == LATEST else (one for one in runs if one.run_id == run))


@contextmanager
def _connection(memory_limit: str) -> Iterator[duckdb.DuckDBPyConnection]:
    # No spilling to disk: the temporary folder cannot be set once external access is off.
    connection = duckdb.connect(":memory:", config={"temp_directory": ""})
    try:
        connection.execute("SET memory_limit = $limit", {"limit": memory_limit})
    except duckdb.Error as error:
        connection.close()
        raise UsageError(
            f"DuckDB does not accept the memory limit ({error})", value=memory_limit, allowed="for instance 2GB"
        ) from None
    for setting in _LOCKS:
        connection.execute(f"SET {setting}")
    try:
        yield connection
    finally:
        connection.close()


def _check_files(results: Path, manifests: Sequence[Manifest], kind: Kind) -> None:
    """Raise IntegrityError unless all files of a kind match the manifest."""
    jobs = [(results / f"{PREFIX}{m.run_id}", entry) for m in manifests for entry in m.of_kind(kind)]
    with ThreadPoolExecutor(max_workers=4) as pool:  # hashing and reading release the GIL
        for _ in pool.map(lambda job: len(read_file(*job)), jobs):
            pass


def _dataset(results: Path, manifests: Sequence[Manifest], kind: Kind) -> ds.Dataset:
    """All committed files of a kind in the registered schema; ``run_id`` follows from the file."""
    files = [(m.run_id, results / f"{PREFIX}{m.run_id}" / e.name) for m in manifests for e in m.of_kind(kind)]
    checked = ds.ParquetFragmentScanOptions(page_checksum_verification=True)
    return ds.FileSystemDataset.from_paths(
        [str(path.resolve()) for _, path in files],
        schema=view_schema(kind),
        format=ds.ParquetFileFormat(default_fragment_scan_options=checked),
        filesystem=LocalFileSystem(),
        partitions=[ds.field("run_id") == run_id for run_id, _ in files],
    )


def _one_select(connection: duckdb.DuckDBPyConnection, sql: str) -> duckdb.Statement:
    try:
        statements = connection.extract_statements(sql)
    except (duckdb.Error, UnicodeError, TypeError) as error:  # lone surrogates are a TypeError
        raise _refused(error, sql) from None
    if len(statements) != 1:
        raise UsageError(
            f"found {len(statements)} SQL statements",
            value=sql,
            allowed="one",
            next_step="run one statement at a time",
        )
    if statements[0].type != duckdb.StatementType.SELECT:
        raise UsageError(
            f"queries only read results, but this is a statement of type {statements[0].type.name}",
            value=sql,
            allowed="one SELECT",
            next_step="to save a result use --format csv, json or parquet; PIVOT needs its IN list",
        )
    return statements[0]


def _answer(connection: duckdb.DuckDBPyConnection, statement: duckdb.Statement, sql: str, timeout_s: float) -> pa.Table:
    done, late = Event(), Event()

    def watch() -> None:
        if done.wait(timeout_s):
            return
        late.set()
        # Repeated, because DuckDB drops an interrupt that arrives between two steps of a statement.
        while not done.wait(0.05):
            connection.interrupt()

    watcher = Thread(target=watch, name="query timeout", daemon=True)
    watcher.start()
    try:
        return _read(pa.RecordBatchReader.from_stream(connection.sql(statement.query)))
    except GyroscreenError:
        raise
    except Exception as error:  # DuckDB passes on any exception of the Arrow scan; all become one typed error.
        if late.is_set():
            raise UsageError(
                f"no result within {timeout_s:g} s",
                value=sql,
                next_step="request less (one run_id, fewer columns, no cross join), or allow more time",
            ) from None
        raise _refused(error, sql) from None
    finally:
        done.set()
        watcher.join()


def _read(reader: pa.RecordBatchReader) -> pa.Table:
    batches, size = [], 0
    for batch in reader:
        size += batch.nbytes
        if size > MAX_ANSWER_BYTES:
            raise UsageError(
                f"the result is larger than {MAX_ANSWER_BYTES >> 20} MiB",
                next_step="aggregate, add LIMIT, or read the tables with pipeline.store.read_run",
            )
        batches.append(batch)
    return pa.Table.from_batches(batches, schema=reader.schema)


def _refused(error: Exception, sql: str) -> GyroscreenError:
    """The typed error for an exception of DuckDB or the Arrow scan, with DuckDB's own hint."""
    message = " ".join(line.strip() for line in str(error).split("\n\nLINE ")[0].splitlines() if line.strip())
    if isinstance(error, (pa.ArrowException, OSError)) or "checksum" in message or "CRC" in message:
        return IntegrityError(f"results cannot be read ({message})", next_step="run `gyroscreen verify`")
    if isinstance(error, duckdb.PermissionException):
        return UsageError(
            f"a query can read stored results only ({message})",
            value=sql,
            allowed="the views devices, posterior, runs, columns",
        )
    if isinstance(error, duckdb.OutOfMemoryException):
        return UsageError(
            "the query needs more memory than it may take", value=sql, next_step=f"request less ({message})"
        )
    return UsageError(
        message, value=sql, allowed="one SELECT on devices, posterior, runs, columns", next_step=_COLUMNS_QUERY
    )


def _with_units(table: pa.Table) -> pa.Table:
    """Number repeated names; restore the unit and meaning of results columns."""
    registered = {field.name: field for kind in ("posterior", "devices") for field in view_schema(kind)}
    seen: Counter[str] = Counter()
    fields = []
    for field in table.schema:
        known = registered.get(field.name)
        named = field.with_metadata(known.metadata) if known is not None and known.type == field.type else field
        fields.append(named if not seen[field.name] else named.with_name(f"{field.name}_{seen[field.name]}"))
        seen[field.name] += 1
    return pa.table(table.columns, schema=pa.schema(fields))
