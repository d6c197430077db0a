"""The run of a batch: blocks in parallel, each committed when it is done; then the examination of misfits and the report.

plan -> blocks -> [dask: draw or read, identify, judge] -> commit -> examine misfits -> finish -> report.html
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pipeline.errors import IncompleteError
from pipeline.store.lock import one_writer
from pipeline.store.run import RunStore
from reports.run.lot_effects import FILE

from ..config import RunConfig
from ..process import worker_count
from .block import BlockTables
from .cluster import cluster
from .compiling import compile_loops
from .dispatch import guarded_in_parallel
from .guard import Begin
from .inputs import faults_in_the_users_folder, with_own_code
from .outcome import RunResult, finish
from .parts import (
    BLOCK_FAULTS,
    Assembly,
    BlockItem,
    block_items,
    block_task,
)
from .plan import RunPlan
from .progress import progress
from .scheduler import Scheduler
from .shipped_code import shipped

BlockTask = Callable[[RunConfig, BlockItem, Begin], BlockTables]


def run_blocks(
    planned: RunPlan,
    store: RunStore,
    workers: int,
    scheduler: Scheduler | None,
    quiet: bool,
    task: BlockTask | None = None,
) -> None:
    """Run the blocks that are not committed yet, commit each when it is done, and examine the misfits.

    ``task`` is what a worker does with a block; ``None``: :func:`block_task`.
    """
    config = planned.config
    done = store.committed_blocks()
    left = [block for block in planned.blocks if block.index not in done]
    examined = not config.diagnosis.enabled or store.page(FILE) is not None
    if not left and examined:
        return
    finished = planned.devices - sum(block.count for block in left)
    count = worker_count(workers or config.run.workers)
    count = min(count, len(left)) if examined else count
    address = None if scheduler is None else scheduler.address
    store.log({"event": "start", "workers": count, "scheduler": address, "blocks": len(left)})
    config, copies, folders = with_own_code(planned.config, planned.inputs)
    remote = {} if scheduler is None else copies
    with cluster(count, scheduler) as client:
        if left:
            compile_loops(client, quiet)
        with (
            shipped(client, remote),
            progress(planned.devices, finished, quiet) as shown,
            faults_in_the_users_folder(folders),
        ):
            limit_s = config.run.device_limit_s
            items, whole = block_items(left, planned.campaigns), Assembly({block.index: block for block in left})
            finished_items = guarded_in_parallel(
                client, task or block_task, config, items, BLOCK_FAULTS, limit_s, watch=None if quiet else shown.partly
            )
            for item, part in finished_items:
                tables = whole.add(item.block, part)
                if item.block.lost:
                    store.log({"event": "lost", "devices": list(BLOCK_FAULTS.devices(item)), "reason": item.block.lost})
                if tables is not None:
                    store.commit_block(tables.index, tables.devices, tables.posterior, tables.irregularities)
                    store.log({"event": "block", "block": tables.index, "statuses": tables.statuses})
                shown.advance(part.devices.num_rows)
            if not examined:
                # It imports the learning half, which blocks do without.
                from .lot.run import examine_run

                examine_run(replace(planned, config=config), store, client, quiet)


def run_batch(
    planned: RunPlan,
    store: RunStore,
    results: Path,
    workers: int = 0,
    scheduler: Scheduler | None = None,
    quiet: bool = True,
) -> RunResult:
    """Run a plan, or the rest of it, up to the report.

    Parameters
    ----------
    planned, store : the plan and the folder of the run.
    results : folder that contains the runs.
    workers : local worker processes; 0: as the configuration says.
    scheduler : dask scheduler whose workers are used instead.
    quiet : show no progress.

    Raises
    ------
    IncompleteError : the run stopped before its end; committed blocks are kept.
    KeyboardInterrupt : as IncompleteError.
    UsageError : another process works on the run.
    """
    started = time.monotonic()
    with one_writer(store.folder):
        try:
            run_blocks(planned, store, workers, scheduler, quiet)
        except (KeyboardInterrupt, IncompleteError):
            store.log({"event": "stopped"})
            if store.committed_blocks():
                store.finish("stopped", {})
            raise
        return finish(store, results, started)
