"""The process that answers one query and ends: ``python -P -m pipeline.sql.process``.

    stdin    a line of JSON (Question), then Arrow streams: files, devices, posterior, irregularities (three empty), runs, columns
    stdout   a byte when the process is ready, then the answer as an Arrow stream
    stderr   a last line of JSON: {"rows": number of rows of the whole answer} or {"error": [..]}

Before it reads SQL the process gives up the right to write files and to take more memory.  It ends when stdin is closed, so it
does not survive the process that started it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import pyarrow as pa

from ..errors import GyroscreenError, UsageError
from .request import READY, TABLES, Question

if sys.platform != "win32":
    import resource

#: Memory beside that of DuckDB's own account: buffers of files and batches, stacks of threads [bytes].
_BESIDE = 1 << 27


class _NoPandas:
    """Keeps pyarrow from importing pandas, half of the start-up time, which no query needs."""

    @staticmethod
    def find_spec(name: str, *_: Any) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name)


def main() -> None:
    """Answer the query on stdin."""
    sys.meta_path.insert(0, _NoPandas)
    from . import locked, verified

    given = sys.stdin.buffer
    request = Question(**json.loads(given.readline()))
    tables = [pa.ipc.open_stream(given).read_all() for _ in range(TABLES)]
    threading.Thread(target=_end_with, args=(given,), daemon=True).start()
    views = verified.views(_report_and_end, *tables)
    with locked.connection(views, _confined(request.memory_bytes)) as opened:
        sys.stdout.buffer.write(READY)
        sys.stdout.buffer.flush()
        try:
            rows = _send(locked.batches(opened, request.sql), request)
        except BaseException as error:
            _report_and_end(locked.refused(error, request.sql))
        _end({"rows": rows})


def _report_and_end(error: GyroscreenError) -> NoReturn:
    _end({"error": [type(error).__name__, error.what, error.value, error.allowed, error.next_step]})


def _end(status: Mapping[str, Any]) -> NoReturn:
    """Report and end at once: threads of DuckDB may still wait for what they read."""
    with suppress(BrokenPipeError):
        sys.stdout.buffer.flush()
    sys.stderr.write("\n" + json.dumps(status) + "\n")
    sys.stderr.flush()
    os._exit(0)


def _send(reader: pa.RecordBatchReader, request: Question) -> int:
    """Write the answer to stdout, of it the first rows only; returns the number of all rows."""
    size, rows = 0, 0
    with pa.ipc.new_stream(sys.stdout.buffer, reader.schema) as writer:
        for batch in _not_empty(reader):
            left = batch.num_rows if request.rows is None else max(request.rows - rows, 0)
            rows += batch.num_rows
            if left == 0:
                continue
            sent = batch.slice(0, left)
            size += sent.nbytes
            if size > request.answer_bytes:
                raise UsageError(
                    f"the result is larger than {request.answer_bytes >> 20} MiB",
                    next_step="aggregate, add LIMIT, or read the tables with pipeline.store.read_run",
                )
            writer.write_batch(sent)
    return rows


def _not_empty(reader: pa.RecordBatchReader) -> Iterator[pa.RecordBatch]:
    return (batch for batch in reader if batch.num_rows)


def _confined(memory_bytes: int) -> int:
    """Give up writing files and taking more memory than this; returns what DuckDB may take of it [bytes]."""
    resident, writable = _memory()
    left = max(memory_bytes - resident, 2 * _BESIDE)
    if sys.platform != "win32":
        for limit in (resource.RLIMIT_FSIZE, resource.RLIMIT_CORE):
            resource.setrlimit(limit, (0, 0))
    if sys.platform == "linux":
        # Writable private memory. Not the address space: each thread reserves much more of it than it uses.
        resource.setrlimit(resource.RLIMIT_DATA, (writable + left, writable + left))
    return left - _BESIDE


def _memory() -> tuple[int, int]:
    """Resident and writable memory of this process [bytes]; 0 where the system does not say."""
    try:
        pages = [int(word) for word in Path("/proc/self/statm").read_text(encoding="ascii").split()]
        return pages[1] * os.sysconf("SC_PAGE_SIZE"), pages[5] * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return 0, 0


def _end_with(given: BinaryIO) -> None:
    given.read()
    os._exit(1)


if __name__ == "__main__":
    main()
