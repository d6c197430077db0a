"""The outcome of a run: its summary, its report, and the gates that the user set on it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.errors import GateError, NegativeError
from pipeline.learning.answers import to_builtins
from pipeline.learning.lot.origin_answers import FILE as ORIGIN
from pipeline.learning.lot.origin_answers import LotOriginAnswers
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.run import RunStore, open_run
from populations.draw import draw
from reports.common_errors import given_common, with_common
from reports.devices import Devices
from reports.html.drawing_process import DrawingProcess, drawing_beside
from reports.limits_origin import LimitsOrigin, recorded_origin
from reports.run import FIGURES
from reports.run import lot_effects as lot_report
from reports.run.health import status_counts
from reports.words.night import status_cause
from reports.words.physics import RunPhysics
from reports.yields import Yield, yield_of_verdicts

from ..attribution.night import attribution_of
from ..config import RunConfig, config_of_run
from ..config_tables import TargetsTable
from .inputs import FILE as INPUTS
from .inputs import read_inputs, with_stored_code
from .settings import mismatch_prior, population
from .shared_errors import shared_shifts
from .virtual_device import virtual_model


@dataclass(frozen=True)
class RunResult:
    """Folder of a run, its devices by verdict and status, its yield with the 95 % interval, and its duration [s].

    There is no yield if no device has the status "ok"; ``main_cause`` is then the most frequent status and its reason.
    """

    run_id: str
    folder: Path
    devices: int
    verdicts: dict[str, int]
    statuses: dict[str, int]
    yield_share: float | None
    yield_interval: tuple[float, float] | None
    lot_effects: tuple[str, ...]
    lot_origin: LotOriginAnswers | None
    main_cause: str | None
    seconds: float
    report: Path | None
    limits: LimitsOrigin

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "run_id": self.run_id,
            "folder": str(self.folder),
            "devices": self.devices,
            "verdicts": self.verdicts,
            "statuses": self.statuses,
            "yield": self.yield_share,
            "yield_interval": None if self.yield_interval is None else list(self.yield_interval),
            "lot_effects": list(self.lot_effects),
            "lot_origin": None if self.lot_origin is None else to_builtins(self.lot_origin),
            "main_cause": self.main_cause,
            "seconds": round(self.seconds, 3),
            "report": None if self.report is None else str(self.report),
            "limits": self.limits.to_dict(),
        }


def write_report(results: Path, run_id: str, beside: DrawingProcess | None = None) -> Path:
    """Render the report of a run and store it in its folder; returns its path.  ``beside`` as in :func:`rendered_report`."""
    return store_report(results, run_id, rendered_report(results, run_id, beside))


def store_report(results: Path, run_id: str, page: str) -> Path:
    """Store the page in the run's folder; returns its path.

    Raises
    ------
    IncompleteError : the folder cannot be written.
    """
    store = open_run(results, run_id)
    store.write_file("report.html", page.encode("utf-8"))
    return store.folder / "report.html"


def rendered_report(results: Path, run_id: str, beside: DrawingProcess | None = None) -> str:
    """The report of a run as HTML; ``beside`` is a process for ``reports.run.FIGURES`` that draws some of them."""
    from reports.run.page import render_run_report  # it loads matplotlib

    store = open_run(results, run_id)
    found, origin = lot_effects(store), lot_origin(store)

    def rendered(tables: StoredRun) -> str:
        config = config_of_stored(results, tables)
        summary = dict(population(config).assumptions()) if config.source.kind == "population" else None
        common = shared_shifts(config, Devices(tables.devices))
        return render_run_report(
            tables,
            config.judged_by(),
            population_summary=summary,
            lot_effects=found,
            physics=physics_of(config),
            common=common,
            limits_origin=recorded_origin(tables.manifest.provenance, bool(config.limits)),
            attribution=attribution_of(config, tables),
            origin=origin,
            beside=beside,
        )

    return with_run(results, run_id, rendered)


def config_of_stored(results: Path, tables: StoredRun) -> RunConfig:
    """The configuration of a run, with the copies of the user's code that it stored: that may have changed since, or be gone."""
    run_id = tables.manifest.run_id
    config = config_of_run(tables.config_toml, f"run.toml of {run_id}")
    inputs = open_run(results, run_id).page(INPUTS)
    return config if inputs is None else with_stored_code(config, read_inputs(inputs, f"{INPUTS} of {run_id}"))


def physics_of(config: RunConfig) -> RunPhysics:
    """What the devices of a run carry, what its model contains, and what the population draws in vain."""
    mismatch = mismatch_prior(config) is not None
    if config.source.kind != "population":
        return RunPhysics(mismatch=mismatch)
    carried = virtual_model(config).effects
    drawn = draw(population(config), config.run.seed, 0, 1).effects
    return RunPhysics(carried, tuple(sorted(set(drawn) - set(carried))), config.noise.kind, mismatch)


def lot_effects(store: RunStore) -> lot_report.LotEffects | None:
    """The findings on the misfits of a run; ``None`` if they were not examined."""
    data = store.page(lot_report.FILE)
    return None if data is None else lot_report.LotEffects.from_json(data)


def lot_origin(store: RunStore) -> LotOriginAnswers | None:
    """Where the lot of a run comes from; ``None`` if that was not asked."""
    data = store.page(ORIGIN)
    return None if data is None else LotOriginAnswers.from_json(data)


def finish(store: RunStore, results: Path, started: float) -> RunResult:
    """Mark the run complete, write the report and summarise the run; ``started`` is its start in monotonic time [s]."""
    with drawing_beside(FIGURES) as beside:
        return _finished(store, results, started, beside)


def _finished(store: RunStore, results: Path, started: float, beside: DrawingProcess | None) -> RunResult:
    found = with_run(results, store.run_id, _counted)
    verdicts, statuses, identified = found.verdicts, found.statuses, found.identified
    seconds = time.monotonic() - started
    examined = lot_effects(store)
    needed = () if examined is None else tuple(sorted({effect.effect for effect in examined.effects}))
    summary = {"verdicts": verdicts, "statuses": statuses, "lot_effects": list(needed), "seconds": round(seconds, 3)}
    store.finish("complete", summary)
    origin = _ask(store, results)
    path = write_report(results, store.run_id, beside)
    store.log({"event": "finish", "verdicts": verdicts, "statuses": statuses})
    return RunResult(
        store.run_id,
        store.folder,
        found.total.devices,
        verdicts,
        statuses,
        found.total.value if identified else None,
        (found.total.clopper_pearson.low, found.total.clopper_pearson.high) if identified else None,
        needed,
        origin,
        found.main_cause,
        time.monotonic() - started,
        path,
        recorded_origin(store.manifest.provenance, True),
    )


def _ask(store: RunStore, results: Path) -> LotOriginAnswers | None:
    """Whether the lot of a night over campaigns comes from the population for screening; stored beside its tables."""
    config = config_of_run(store.config_toml, f"run.toml of {store.run_id}")
    if config.source.kind != "campaigns" or not config.lot_origin.enabled:
        return None
    from ..lots.night import night_answers  # it imports the learning half

    found = night_answers(results, store.run_id, config)
    store.write_file(ORIGIN, found.to_json())
    store.log({"event": "lot origin", "origin": found.origin.verdict, "drift": found.drift.verdict})
    return found


@dataclass(frozen=True)
class _Counted:
    """What the tables of a run say together."""

    verdicts: dict[str, int]
    statuses: dict[str, int]
    identified: bool
    total: Yield
    main_cause: str | None


def _counted(tables: StoredRun) -> _Counted:
    devices = Devices(tables.devices)
    rule = config_of_run(tables.config_toml, f"run.toml of {tables.manifest.run_id}").judged_by().rule
    verdicts, identified = devices.text("verdict"), devices.identified()
    total = with_common(yield_of_verdicts(verdicts), given_common(devices, tables.posterior, rule))
    causes: dict[str, int] = {}
    for cell, number in devices.text("failed_limits").counts().items():
        for cause in filter(None, cell.split(",")):
            causes[cause] = causes.get(cause, 0) + number
    main = max(causes, key=lambda name: causes[name]) if causes else None
    return _Counted(
        {"pass": 0, "fail": 0, "undecided": 0} | verdicts.counts(),
        {"ok": 0, "not_converged": 0, "misfit": 0, "fit_failed": 0, "lost": 0} | devices.text("status").counts(),
        identified,
        total,
        main if identified else status_cause(status_counts(devices)),
    )


def check_identified(result: RunResult) -> None:
    """Check that the night has an answer.

    Raises
    ------
    NegativeError : no device could be identified.
    """
    if result.yield_share is None:
        raise NegativeError(
            f"no device could be identified, so there is no yield ({result.main_cause or 'the run has no devices'})",
            allowed="at least one device with the status ok",
            next_step=f"see {result.report}; check drive, band and noise of the configuration, or the measurements",
        )


def check_targets(targets: TargetsTable, result: RunResult) -> None:
    """Check the gates that the user set on the whole run.

    Raises
    ------
    GateError : the yield is below targets.yield_min, or a device did not converge under targets.strict_convergence.
    """
    if targets.yield_min is not None and (result.yield_share is None or result.yield_share < targets.yield_min):
        raise GateError(
            "the yield is below targets.yield_min",
            value=None if result.yield_share is None else round(result.yield_share, 4),
            allowed=f"at least {targets.yield_min:g}",
            next_step=f"see {result.report}",
        )
    failed = sum(result.statuses[status] for status in ("not_converged", "fit_failed", "lost"))
    if targets.strict_convergence and failed:
        raise GateError(
            "devices without a converged posterior",
            value=failed,
            allowed="none, because targets.strict_convergence is set",
            next_step="gyroscreen query \"SELECT device_id, status_reason FROM devices WHERE status <> 'ok'\"",
        )
