"""The end of a night over measured campaigns: does the lot come from the population for screening, and did it drift?

    devices table of the night --lot_of_table--> MeasuredLot, its population at the same dies --origin--> answer
    the same with the devices of earlier nights                                               --drift--> answer

Errors that all devices of a tester share ([systematic]) are a random part of both questions, common to all devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.errors import GyroscreenError
from pipeline.learning.lot.gyro import COORDINATES, NEEDED, coordinates
from pipeline.learning.lot.lot_file import LotFile, LotHold, LotWafer
from pipeline.learning.lot.measured import LEAST_DEVICES, MeasuredLot
from pipeline.learning.lot.model import RandomPart
from pipeline.learning.lot.origin import drift, origin
from pipeline.learning.lot.origin_answers import DriftAnswer, LotOriginAnswers, OriginAnswer
from pipeline.learning.lot.population import LotPopulation
from pipeline.learning.lot.table import lot_of_table
from pipeline.store.read import list_runs, read_run
from populations.spec import PopulationSpec
from reports.devices import Devices

from ..config import RunConfig
from ..config_tables import LotOriginTable
from ..screening.settings import lot_population
from ..screening.shared_errors import shared_shifts
from ..trend.nights import StoredNight, select, stored_night
from .population import population_at

#: Devices of earlier nights that the drift looks at: twice as many take twice the time, and tell little more about one night.
MOST_EARLIER = 4000
_PLACE = ("lot", "wafer", "die_x_mm", "die_y_mm")
#: What stops an answer, not the night.
_FAILURES = (GyroscreenError, ArithmeticError, ValueError, np.linalg.LinAlgError)


def night_answers(results: Path, run_id: str, config: RunConfig) -> LotOriginAnswers:
    """The answers for a run; "undecided" with the reason where it has too few devices or the places are not stated.

    Raises
    ------
    IntegrityError : a run is not what was committed.
    """
    spec, asked = lot_population(config), config.lot_origin
    table = placed(read_run(results, run_id).devices)
    with threadpool_limits(limits=1):
        return LotOriginAnswers(
            _origin(table, spec, config),
            _drift(results, run_id, table, spec, config) if asked.nights else _no_drift(asked),
        )


def placed(devices: pa.Table) -> pa.Table:
    """The identified devices whose campaign states lot, wafer and place, each part once."""
    rows, seen = [], set()
    columns = [devices[name].to_pylist() for name in ("status", "part", "device_id", *_PLACE)]
    for k, (status, part, device, *place) in enumerate(zip(*columns)):
        if status == "ok" and None not in place and (part or device) not in seen:
            seen.add(part or device)
            rows.append(k)
    return devices.take(pa.array(rows, pa.int64()))


def measured_lot(table: pa.Table, spec: PopulationSpec, name: str) -> MeasuredLot:
    """The devices of ``table`` as a lot; none is held out.

    Raises
    ------
    MeasurementError : too few devices, or none with a finite quantity.
    """
    radius = LotWafer(radius_mm=spec.wafer.diameter_mm / 2.0)
    file = LotFile(file="devices", gyro=True, wafer=radius, hold=LotHold(share=0.0))
    return lot_of_table(table, file, name, f"run {name}").lot


def _origin(table: pa.Table, spec: PopulationSpec, config: RunConfig) -> OriginAnswer:
    def undecided(reason: str) -> OriginAnswer:
        return OriginAnswer(spec.name, table.num_rows, "undecided", None, config.lot_origin.false_alarm, reason=reason)

    if table.num_rows < LEAST_DEVICES:
        return undecided(_too_few(table))
    try:
        lot = measured_lot(table, spec, "tonight")
        population = with_common_errors(population_at(spec, lot), lot, table, config)
        return origin(lot, population, config.lot_origin.false_alarm, config.run.seed)
    except _FAILURES as error:
        return undecided(_failed(error))


def _drift(results: Path, run_id: str, table: pa.Table, spec: PopulationSpec, config: RunConfig) -> DriftAnswer:
    asked = config.lot_origin
    if table.num_rows < LEAST_DEVICES:
        return _no_drift(asked, table.num_rows, _too_few(table))
    try:
        nights = _earlier(results, run_id, table, asked.nights)
        if not nights:
            return _no_drift(asked, table.num_rows, "there is no earlier night with other devices to compare with")
        whole = pa.concat_tables([table, *(devices for _, devices in nights)])
        lot = measured_lot(whole, spec, "nights")
        population = with_common_errors(population_at(spec, lot), lot, whole, config)
        tonight = np.isin(np.array(lot.device), np.array(table["device_id"].to_pylist()))
        return drift(lot, tonight, population, [name for name, _ in nights], asked.false_alarm, config.run.seed)
    except _FAILURES as error:
        return _no_drift(asked, table.num_rows, _failed(error))


def _no_drift(asked: LotOriginTable, devices: int = 0, reason: str = "[lot_origin] nights is 0") -> DriftAnswer:
    return DriftAnswer((), devices, 0, "undecided", None, asked.false_alarm, reason=reason)


def _too_few(table: pa.Table) -> str:
    return f"{table.num_rows} identified devices state lot, wafer and die_x_mm, die_y_mm in [device] of their campaign.toml"


def _failed(error: Exception) -> str:
    text = str(error).splitlines()
    return (
        text[0]
        if text and isinstance(error, GyroscreenError)
        else f"the model could not be fitted ({type(error).__name__})"
    )


def _earlier(results: Path, run_id: str, tonight: pa.Table, most: int) -> list[tuple[str, pa.Table]]:
    """Comparable earlier nights, the latest first, with the devices that no later night has."""
    runs = list_runs(results)
    at = [manifest.run_id for manifest in runs].index(run_id)
    chosen: Sequence[StoredNight] = select(results, stored_night(results, runs[at]), runs[:at], most).earlier
    found: list[tuple[str, pa.Table]] = []
    seen = set(tonight["device_id"].to_pylist())
    count = 0
    for night in reversed(chosen):
        devices = placed(read_run(results, night.run_id).devices)
        new = devices.filter(pa.array([name not in seen for name in devices["device_id"].to_pylist()], pa.bool_()))
        if new.num_rows and count + new.num_rows <= max(MOST_EARLIER, tonight.num_rows):
            seen |= set(new["device_id"].to_pylist())
            count += new.num_rows
            found.append((night.run_id, new))
    return found


def with_common_errors(
    population: LotPopulation, lot: MeasuredLot, table: pa.Table, config: RunConfig
) -> LotPopulation:
    """The population with the errors that all devices of the tester share, each a normal that is common to all devices."""
    rows = {name: k for k, name in enumerate(table["device_id"].to_pylist())}
    own = table.take(pa.array([rows[name] for name in lot.device]))
    devices = Devices(own)
    shifts = shared_shifts(config, devices)
    if not shifts:
        return population
    at = {name: np.nan_to_num(devices.number(name)) for name in NEEDED}
    base = coordinates(at)
    count = len(next(iter(shifts.values())))
    columns = [
        coordinates(
            {name: at[name] + np.nan_to_num(shifts[name][e]) if name in shifts else at[name] for name in NEEDED}
        )
        - base
        for e in range(count)
    ]
    chosen = [COORDINATES.index(name) for name in lot.quantities]
    found: FloatArray = np.nan_to_num(np.stack(columns, axis=-1)[:, chosen])
    parts = tuple(
        RandomPart(f"tester.{e + 1}", "all", found[:, :, e : e + 1]) for e in range(count) if np.any(found[:, :, e])
    )
    return replace(population, model=replace(population.model, random=(*population.model.random, *parts)))
