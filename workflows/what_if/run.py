"""A stored run judged again by new limits, without a new run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import ConfigError, UsageError
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.run import open_run
from reports.common_errors import GivenCommon, given_common
from reports.devices import Devices
from reports.limits import Limits
from reports.what_if.content import WhatIf, what_if
from reports.what_if.judge import judge_again
from reports.what_if.table import replaced

from ..screening.inputs import FILE as INPUTS
from ..screening.outcome import config_of_stored
from ..screening.shared_errors import shared_shifts
from .common import given_new_limits
from .gate import status_by
from .rate import common_rate
from .stored import StoredDraws


@dataclass(frozen=True, eq=False)
class JudgedRun:
    """The content of the page, and the devices by the old and by the new limits."""

    content: WhatIf
    before: Devices
    after: Devices
    given: GivenCommon | None


def judged_run(results: Path, run_id: str, limits: Limits, limits_name: str) -> JudgedRun:
    """The run ``run_id`` in ``results``, judged by ``limits`` from the file ``limits_name``.

    Raises
    ------
    ConfigError : the limits name a quantity of which the run knows nothing.
    UsageError : no device of the run can be judged.
    IntegrityError : a stored file is not what was committed.
    """
    inputs = open_run(results, run_id).page(INPUTS)

    def judged(tables: StoredRun) -> JudgedRun:
        config = config_of_stored(results, tables)
        old = config.judged_by()
        before = Devices(tables.devices)
        names = tuple(dict.fromkeys((*old.quantities, *limits.quantities)))
        draws = StoredDraws(config, before, tables.posterior, names, common_rate(config, inputs, run_id))
        _check(draws, limits, limits_name)
        status = status_by(before, config, old, limits)
        wanted = status.equals("ok")
        if not wanted.any():
            raise UsageError(
                "no device of the run can be judged",
                value=before.text("status").counts(),
                allowed="at least one device with the status ok by the gate of the new limits",
                next_step='gyroscreen query "SELECT status, status_reason FROM devices" says why',
            )
        use_draws = draws.per_device > 0 or not limits.rule.by_estimate
        again = judge_again(before, old, limits, status, draws.batches(wanted) if use_draws else (), before.wafers())
        given = given_new_limits(draws, wanted, given_common(before, tables.posterior, old.rule), old, limits)
        texts = {"status": again.status, "verdict": again.verdict, "failed_limits": again.failed_limits}
        after = Devices(replaced(tables.devices, texts, {"p_pass": again.p_pass}))
        common = shared_shifts(config, before)
        thinning = None if limits.rule.by_estimate else (draws.per_device, draws.chain_draws(), draws.normal)
        content = what_if(
            run_id, before, after, tables.posterior, given, again, old, limits, thinning, limits_name, common
        )
        return JudgedRun(content, before, after, given)

    return with_run(results, run_id, judged)


def _check(draws: StoredDraws, limits: Limits, where: str) -> None:
    absent = [name for name in draws.absent() if name in limits.quantities]
    if absent:
        raise ConfigError(
            f"{where}: the run knows nothing of a limited quantity",
            value=absent,
            allowed=", ".join(draws.known()) or "no quantity: no device was identified",
            next_step="limit one of these, or declare what it needs (docs/explanation/performance.md) and run again",
        )
