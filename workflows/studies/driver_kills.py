"""Kills of the driver: a run of stub devices whose driver is ended with SIGKILL at random moments and resumed each time.

Each life of the driver is a forked process that does what `gyroscreen run --resume` does: takes the lock of the writer, starts
workers, runs the blocks that are not committed, closes the run.  Its parent ends it, and checks that no committed block is lost.
"""

from __future__ import annotations

import json
import math
import os
import random
import signal
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from pipeline.store.folders import PREFIX
from pipeline.store.lock import one_writer
from pipeline.store.log import NAME as LOG
from pipeline.store.read import find_run, read_run
from pipeline.store.run import RunStore, create_run
from pipeline.store.verify import verify

from ..config import RunConfig
from ..config_tables import DiagnosisTable, RunTable
from ..screening.batch import run_blocks
from ..screening.block import DeviceBlock, blocks_of
from ..screening.guard import unguarded
from ..screening.inputs import Inputs
from ..screening.parts import BlockItem
from ..screening.plan import RunPlan
from .faults import Stub

DEVICES = 4
_RUN, _LOG, _COUNT = "kills", "kills.jsonl", "count"
#: This share of the kills falls into the start of the driver [s], the others after its first commit; both at random.
_EARLY, _START_S = 0.25, 4.0


def stub_plan(blocks: int) -> RunPlan:
    """The plan of a run of ``blocks`` blocks of stub devices."""
    config = RunConfig(run=RunTable(devices=blocks * DEVICES, block=DEVICES), diagnosis=DiagnosisTable(enabled=False))
    return RunPlan(config, blocks * DEVICES, blocks_of(config, blocks * DEVICES), (), Inputs((), {}))


def killed_drivers(blocks: int, kills: int, seconds: float, workers: int, seed: int, folder: Path) -> dict[str, Any]:
    """Figures of a run whose driver is killed ``kills`` times; ``folder`` keeps the run, so a stopped study goes on."""
    (folder / _COUNT).mkdir(parents=True, exist_ok=True)
    results, log = folder / "results", folder / _LOG
    if not (results / f"{PREFIX}{_RUN}").exists():
        create_run(results, _RUN, "", {})
    store = RunStore(find_run(results, _RUN))
    done = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    while len(done) < kills and store.manifest.status != "complete":
        before = store.committed_blocks()
        chance = random.Random(seed * 1_000_003 + len(done))
        early = chance.random() < _EARLY
        moment = chance.uniform(0.0, _START_S if early else 2.0 * blocks * DEVICES * seconds / workers / kills)
        sooner = computed(folder)
        killed = _life(store, blocks, seconds, workers, folder, early, moment)
        after = store.committed_blocks()
        row = {"killed": killed, "committed": len(after), "lost": len(before - after)}
        done.append({**row, "computed": computed(folder) - sooner, "fresh": (len(after) - len(before)) * DEVICES})
        with log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(done[-1]) + "\n")
    if store.manifest.status != "complete":
        _life(store, blocks, seconds, workers, folder, True, math.inf)
    return _figures(results, blocks, done, computed(folder))


def computed(folder: Path) -> int:
    """Number of devices computed so far."""
    return sum(file.stat().st_size for file in (folder / _COUNT).iterdir())


def _life(store: RunStore, blocks: int, seconds: float, workers: int, folder: Path, early: bool, moment: float) -> bool:
    """One driver; whether it was killed, ``moment`` seconds after its start, or (not ``early``) after its first commit."""
    log = store.folder / LOG
    size = log.stat().st_size if log.exists() else 0
    child = os.fork()
    if child == 0:
        code = 1
        try:
            with one_writer(store.folder):
                run_blocks(stub_plan(blocks), store, workers, None, True, Stub(seconds, count=folder / _COUNT))
                store.finish("complete", {})
                code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    until = time.monotonic() + moment if early else math.inf
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            if os.waitstatus_to_exitcode(status):
                raise RuntimeError(f"a driver ended with {os.waitstatus_to_exitcode(status)}")
            return False
        if until == math.inf and not early and log.exists() and b'"event":"block"' in log.read_bytes()[size:]:
            until = time.monotonic() + moment
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


def _figures(results: Path, blocks: int, done: Sequence[dict[str, Any]], devices: int) -> dict[str, Any]:
    rows = read_run(results, _RUN).devices
    expected = pa.concat_tables(
        Stub()(RunConfig(), BlockItem(DeviceBlock(n, n * DEVICES, DEVICES)), unguarded).devices for n in range(blocks)
    )
    kills = sum(one["killed"] for one in done)
    return {
        "blocks": blocks,
        "drivers killed": kills,
        "drivers killed while they worked": sum(one["killed"] and one["computed"] > 0 for one in done),
        "committed blocks lost": sum(one["lost"] for one in done),
        "table as undisturbed": rows.equals(expected),
        "findings of verify": len(verify(results).findings),
        "extra devices computed / devices": devices / (blocks * DEVICES) - 1.0,
        "extra devices computed per kill": (devices - blocks * DEVICES) / max(kills, 1),
    }
