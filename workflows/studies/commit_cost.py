"""Cost of commits over many blocks of stub devices, and of what follows: closing the run, a query, the report.

Processor time is counted, not the time that the disk takes to confirm a write (three fsync a block, whatever the block's number).
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from statistics import fmean
from typing import Any

import psutil
import tomli_w

from pipeline.store.folders import PREFIX
from pipeline.store.query import query
from pipeline.store.read import find_run
from pipeline.store.run import RunStore, create_run
from pipeline.store.verify import verify

from ..config import RunConfig, to_toml_table
from ..screening.block import DeviceBlock
from ..screening.guard import unguarded
from ..screening.outcome import rendered_report
from ..screening.parts import BlockItem
from ..screening.plan import without_none
from .driver_kills import DEVICES
from .faults import Stub

_RUN, _LOG, _PART = "commits", "commits.jsonl", 500
_SQL = "SELECT verdict, count(*) AS n, avg(theta_deg) AS theta FROM devices GROUP BY verdict"


def commits(blocks: int, folder: Path) -> dict[str, Any]:
    """Figures of ``blocks`` commits and of the run that they make; ``folder`` keeps the run, so a stopped study goes on."""
    results, log = folder / "results", folder / _LOG
    if not (results / f"{PREFIX}{_RUN}").exists():
        create_run(results, _RUN, tomli_w.dumps(without_none(to_toml_table(RunConfig()))), {"seed": 0})
    store = RunStore(find_run(results, _RUN))
    first = len(store.committed_blocks())
    while first < blocks:
        last = min(first + _PART - first % _PART, blocks)
        line = {**_part(store, first, last), "pid": os.getpid(), "MB": _megabytes()}
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        first = last
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    found: dict[str, Any] = {
        "blocks": blocks,
        "devices": blocks * DEVICES,
        "commit, first blocks, ms": lines[0]["ms"],
        "commit, last blocks, ms": lines[-1]["ms"],
        "commit, largest mean of 500 blocks, ms": max(line["ms"] for line in lines),
        "commit, mean, ms": fmean(line["ms"] for line in lines),
        "growth of memory, MB": max(_growth(lines, line) for line in lines),
        "files before the end": len(list(store.folder.iterdir())),
    }
    if store.manifest.status != "complete":
        found |= _timed("finish", lambda: store.finish("complete", {}))
    found["files"] = len(list(store.folder.iterdir()))
    found |= _timed("query", lambda: query(_SQL, results))
    found |= _timed("report", lambda: rendered_report(results, _RUN))
    found |= _timed("verify", lambda: verify(results).require())
    return found


def _part(store: RunStore, first: int, last: int) -> dict[str, Any]:
    """Processor time of a commit [ms], as the mean over blocks ``first`` to ``last``, merging of files included."""
    stub, seconds, most = Stub(), 0.0, 0.0
    for index in range(first, last):
        devices = stub(RunConfig(), BlockItem(DeviceBlock(index, index * DEVICES, DEVICES)), unguarded).devices
        started = time.process_time()
        store.commit_block(index, devices, None)
        took = time.process_time() - started
        seconds, most = seconds + took, max(most, took)
    return {"blocks": last, "ms": 1e3 * seconds / (last - first), "most ms": 1e3 * most}


def _megabytes() -> float:
    return float(psutil.Process().memory_info().rss) / 1e6


def _growth(lines: list[dict[str, Any]], line: dict[str, Any]) -> float:
    """Memory beyond that after the first part of the same process [MB]."""
    first = next(one for one in lines if one["pid"] == line["pid"])
    return float(line["MB"]) - float(first["MB"])


def _timed(name: str, work: Callable[[], object]) -> dict[str, float]:
    before, started, wall = _megabytes(), time.process_time(), time.perf_counter()
    work()
    return {
        f"{name}, s of processor time": time.process_time() - started,
        f"{name}, s": time.perf_counter() - wall,
        f"{name}, growth of memory, MB": _megabytes() - before,
    }
