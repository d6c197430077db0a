"""One point, measured in a process of its own: processor time, memory, files, query, report.

Processor time is what the point costs on any machine; wall time depends on what else this one does.  Memory is the peak of the
process that drives the run, and of the largest of its workers.
"""

from __future__ import annotations

import multiprocessing
import resource
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w

from pipeline.experiment.noise.measure import measured as measured_volts
from pipeline.experiment.record import Campaign, Record
from pipeline.experiment.write_campaign import write_campaign
from pipeline.store.query import query
from pipeline.store.run import RunStore, create_run
from populations.draw import draw

from ...config import RunConfig, to_toml_table
from ...config_tables import SourceTable
from ...screening.batch import run_blocks
from ...screening.block import DeviceBlock, blocks_of, virtual_block
from ...screening.campaign_block import campaign_block
from ...screening.inputs import Inputs
from ...screening.outcome import rendered_report
from ...screening.plan import RunPlan, plan, without_none
from ...screening.settings import population
from ...screening.virtual_device import shared_record, virtual_records, virtual_volts
from .points import DEVICE, RECORDS, Point, config_of_point
from .stub import StubRows

_RUN, _STREAM = "scaling", 113
_SQL = "SELECT wafer, avg(split_hz) AS split, sum(CAST(verdict = 'pass' AS INT)) AS passed FROM devices GROUP BY wafer"
#: The process of a query may take so long [s] and so much: a run of a million devices has 2 GB of rows.
_QUERY_S, _QUERY_MEMORY = 1800.0, "4GB"


def measured(point: Point, seed: int, folder: Path) -> dict[str, Any]:
    """The row of a point; its files are below ``folder`` while it is measured, and removed afterwards.

    Raises
    ------
    IncompleteError, IntegrityError, UsageError : as a run and a query.
    """
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        return process.submit(_row, point, seed, folder).result()


def _row(point: Point, seed: int, folder: Path) -> dict[str, Any]:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        config = config_of_point(point, seed)
        found = _in_process(point, config, folder) if point.workers == 0 else _run(point, config, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {
        "kind": point.kind,
        "number": point.number,
        "seed": seed,
        "value": point.value,
        "workers": point.workers,
    } | {
        "devices": point.devices,
        **found,
    }


def _timed(name: str, work: Callable[[], Any]) -> dict[str, float]:
    """Processor time of ``work`` here and in processes that it started and that ended, and wall time [s]."""
    children, own, wall = _children_s(), time.process_time(), time.perf_counter()
    work()
    return {
        f"{name}_cpu_s": time.process_time() - own,
        f"{name}_workers_cpu_s": _children_s() - children,
        f"{name}_s": time.perf_counter() - wall,
    }


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _peak_mb(who: int) -> float:
    return resource.getrusage(who).ru_maxrss / 1024.0


def _files(folder: Path) -> dict[str, float]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {"files": len(files), "bytes": sum(path.stat().st_size for path in files)}


def _run(point: Point, config: RunConfig, folder: Path) -> dict[str, Any]:
    """A run on workers, of real devices or of stubs, then its end, a query and its report."""
    store: RunStore = create_run(folder, _RUN, tomli_w.dumps(without_none(to_toml_table(config))), {"seed": 0})
    if point.kind == DEVICE:
        planned, task = plan(config), None
    else:
        blocks = blocks_of(config, point.devices)
        planned, task = RunPlan(config, point.devices, blocks, (), Inputs((), {})), StubRows()
    found: dict[str, Any] = _timed("run", lambda: run_blocks(planned, store, point.workers, None, True, task))
    found["blocks"] = len(planned.blocks)
    # The queries that follow are children, too.
    found |= {"peak_mb": _peak_mb(resource.RUSAGE_SELF), "worker_peak_mb": _peak_mb(resource.RUSAGE_CHILDREN)}
    found |= _timed("close", lambda: store.finish("complete", {}))
    found |= _files(store.folder)
    found |= _timed("query", lambda: query(_SQL, folder, timeout_s=_QUERY_S, memory_limit=_QUERY_MEMORY))
    found |= _timed("report", lambda: rendered_report(folder, _RUN))
    return found | {"report_peak_mb": _peak_mb(resource.RUSAGE_SELF)}


def _in_process(point: Point, config: RunConfig, folder: Path) -> dict[str, Any]:
    """A block of devices in this process, after a block that loads the code."""
    block = DeviceBlock(0, 0, point.devices)
    if point.kind != RECORDS:
        virtual_block(config, DeviceBlock(0, 0, 1))
        found = _timed("run", lambda: virtual_block(config, block))
        return found | {"peak_mb": _peak_mb(resource.RUSAGE_SELF)}
    _write_campaigns(config, point.devices, int(point.value), folder)
    source = SourceTable(kind="campaigns", path=str(folder))
    planned = plan(msgspec.structs.replace(config, source=source))
    files = _files(folder)
    campaign_block(planned.config, DeviceBlock(0, 0, 1), planned.campaigns[:1])
    found = _timed("run", lambda: campaign_block(planned.config, block, planned.campaigns))
    return found | files | {"peak_mb": _peak_mb(resource.RUSAGE_SELF)}


def _write_campaigns(config: RunConfig, devices: int, records: int, folder: Path) -> None:
    """Campaigns of a silent record and ``records`` chirps of the run each, with noise of their own."""
    spec = population(config)
    drawn, gain = draw(spec, config.run.seed, 0, devices), float(spec.angular_gain)
    instrument, drive = config.instrument.instrument(), shared_record(config).record.drive_v
    hum, kind = config.hum_source(), config.noise.noise_kind()
    for i in range(devices):
        silent, first, sigma_v = virtual_records(config, drawn, i)
        volts = virtual_volts(config, drawn, i)
        random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM, i)))
        rate = instrument.sample_rate_hz
        more = [measured_volts(volts, rate, sigma_v, hum, instrument.adc, random, kind) for _ in range(records - 1)]
        quiet = Record("silence", rate, np.zeros_like(silent), silent, role="noise")
        chirps = [Record(f"chirp {k}", rate, drive, v, role="fit") for k, v in enumerate([first, *more], start=1)]
        write_campaign(Campaign(f"device-{i}", (quiet, *chirps), instrument, gain), folder / f"device-{i}")
