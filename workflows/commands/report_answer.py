"""gyroscreen report --json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.learning.answers import to_builtins
from pipeline.plain import plain
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.run import open_run
from reports.capability import capabilities
from reports.common_errors import given_common, with_common
from reports.decision_risk import K_CURVE, decision_risks, risk_curve
from reports.devices import Devices
from reports.yields import yield_of_verdicts

from ..screening.outcome import config_of_stored, lot_origin
from ..screening.shared_errors import shared_shifts
from ..what_if.tables import capability_table, limits_table, risk_curve_table, risk_table, yield_table


def report_answer(results: Path, run_id: str, page: Path) -> dict[str, Any]:
    """Yield, risks and capability of a run as plain data; ``page`` is its report."""

    origin = lot_origin(open_run(results, run_id))

    def counted(tables: StoredRun) -> dict[str, Any]:
        config = config_of_stored(results, tables)
        limits, devices = config.judged_by(), Devices(tables.devices)
        common = shared_shifts(config, devices)
        total = with_common(
            yield_of_verdicts(devices.text("verdict")), given_common(devices, tables.posterior, limits.rule)
        )
        found: dict[str, Any] = plain(
            {
                "run_id": run_id,
                "report": str(page),
                **limits_table(limits),
                "total": yield_table(total),
                "lot_origin": None if origin is None else to_builtins(origin),
                "risks": [risk_table(row) for row in decision_risks(devices, limits, common)],
                "risk_curve": risk_curve_table(risk_curve(devices, limits, K_CURVE)),
                "capability": [capability_table(row) for row in capabilities(devices, limits, common)],
            }
        )
        return found

    return with_run(results, run_id, counted)
