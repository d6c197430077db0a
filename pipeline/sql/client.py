"""Ask the process of a query, and end it when it exceeds its time or memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import pyarrow as pa

from ..errors import IncompleteError, UsageError
from .request import READY, Question, error_of, too_much_memory, write_table

_LOOK_S = 0.02
#: Longest time from the start of the process to its first sign of life [s].
_START_S = 60.0
#: Environment that Python itself needs; SQL sees nothing else of it.
_KEPT = ("PATH", "SYSTEMROOT", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "LANG", "LC_ALL", "TZ")


@dataclass(frozen=True, eq=False)
class SqlAnswer:
    """The first rows of an answer, and the number of all."""

    table: pa.Table
    rows: int


@dataclass
class _Received:
    """What the threads that read the pipes have received."""

    ready_s: float | None = None
    batches: list[pa.RecordBatch] = field(default_factory=list)
    schema: pa.Schema | None = None
    notes: bytes = b""


class QueryProcess:
    """A process for one query; it starts at once, so that it imports while the question is prepared."""

    def __init__(self) -> None:
        environment = {name: os.environ[name] for name in _KEPT if name in os.environ}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        environment |= {
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }  # numpy comes with duckdb and computes nothing
        # -P: the working folder is not searched for imports.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "pipeline.sql.process"],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.peak_bytes = 0

    def __enter__(self) -> QueryProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            with suppress(OSError, ValueError):
                pipe.close()  # type: ignore[union-attr]

    def ask(self, request: Question, tables: Iterable[pa.Table], timeout_s: float) -> SqlAnswer:
        """The answer to ``request`` on ``tables`` (as the process reads them) within ``timeout_s``.

        Raises
        ------
        UsageError : SQL that is refused; time, memory or the size of the answer are exceeded.
        IntegrityError : a file is not what was committed.
        IncompleteError : the process did not start.
        """
        got = _Received()
        pipes = self._process
        assert pipes.stdin is not None
        assert pipes.stdout is not None
        assert pipes.stderr is not None
        readers = [_thread(_receive, pipes.stdout, got), _thread(_note, pipes.stderr, got)]
        writer = _thread(_write, pipes.stdin, request, tables)
        try:
            self._watch(request, got, timeout_s)
        except BaseException:
            pipes.kill()
            raise
        finally:
            for thread in (*readers, writer):
                thread.join()
        status = _status(got.notes)
        if "error" in status:
            raise error_of(status["error"])
        if "rows" not in status or got.schema is None:
            raise self._ended(request, got)
        return SqlAnswer(pa.Table.from_batches(got.batches, got.schema), status["rows"])

    def _watch(self, request: Question, got: _Received, timeout_s: float) -> None:
        """Until the process ends; raises when it exceeds a limit."""
        import psutil  # loading it takes 20 ms, and other commands that read a run do not need it

        started, process = time.monotonic(), psutil.Process(self._process.pid)
        while self._process.poll() is None:
            with suppress(psutil.Error):
                self.peak_bytes = max(self.peak_bytes, process.memory_info().rss)
            if self.peak_bytes > request.memory_bytes and got.ready_s is not None:
                raise too_much_memory(request.sql)
            now = time.monotonic()
            if got.ready_s is None and now > started + _START_S:
                raise IncompleteError(
                    f"the process of the query did not start within {_START_S:g} s", next_step="repeat the query"
                )
            if got.ready_s is not None and now > got.ready_s + timeout_s:
                raise UsageError(
                    f"no result within {timeout_s:g} s",
                    value=request.sql,
                    next_step="request less (one run_id, fewer columns, no cross join), or allow more time",
                )
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_LOOK_S)

    def _ended(self, request: Question, got: _Received) -> Exception:
        """The error for a process that ended without an answer."""
        if got.ready_s is None:
            last = got.notes.decode(errors="replace").strip().splitlines()[-1:]
            return IncompleteError("the process of the query did not start", value=" ".join(last) or None)
        # Where an allocation fails in the middle of compiled code, the process ends by a signal.
        return too_much_memory(request.sql)


def _thread(target: Callable[..., None], *arguments: Any) -> threading.Thread:
    thread = threading.Thread(target=target, args=arguments, daemon=True)
    thread.start()
    return thread


def _write(pipe: BinaryIO, request: Question, tables: Iterable[pa.Table]) -> None:
    with suppress(OSError, ValueError):  # the process has ended
        pipe.write(request.line())
        for table in tables:
            write_table(pipe, table)
        pipe.flush()


def _receive(pipe: BinaryIO, got: _Received) -> None:
    with suppress(OSError, ValueError, pa.ArrowException):  # the process has ended
        if pipe.read(1) != READY:
            return
        got.ready_s = time.monotonic()
        with pa.ipc.open_stream(pipe) as reader:
            got.schema = reader.schema
            got.batches.extend(reader)
        pipe.read()


def _note(pipe: BinaryIO, got: _Received) -> None:
    with suppress(OSError, ValueError):
        while data := pipe.read1(1 << 16):  # type: ignore[attr-defined]
            got.notes = (got.notes + data)[-(1 << 20) :]


def _status(notes: bytes) -> Mapping[str, Any]:
    """The last line of stderr, if it is a status."""
    with suppress(ValueError, IndexError):
        found = json.loads(notes.decode().strip().splitlines()[-1])
        if isinstance(found, dict):
            return found
    return {}
