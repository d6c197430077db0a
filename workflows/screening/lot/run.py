"""The examination of a run's misfits on its workers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from distributed import Client

from pipeline.store.columns import with_run
from pipeline.store.run import RunStore
from reports.devices import ColumnSource
from reports.run.lot_effects import FILE, LotEffects

from ..dispatch import guarded_in_parallel
from ..plan import RunPlan
from ..progress import progress
from .device import DeviceExamination, Request
from .effects import Columns, examine
from .task import EXAMINE_FAULTS, ExamineItem, examine_task


def examine_run(planned: RunPlan, store: RunStore, client: Client, quiet: bool) -> None:
    """Find the effects that misfits lack; add them to the devices table and store the findings in the run's folder."""
    found, columns = with_run(
        store.folder.parent, store.run_id, lambda run: examination(planned, store, run.devices, client, quiet)
    )
    store.amend_devices(columns)
    store.write_file(FILE, found.to_json())
    store.log({"event": "examined", "effects": [effect.effect for effect in found.effects]})


def examination(
    planned: RunPlan, store: RunStore, devices: ColumnSource, client: Client, quiet: bool
) -> tuple[LotEffects, Columns]:
    """What the misfits of a run lack, and the columns to amend: a pure function of the plan and of its devices."""

    def examine_devices(requests: Sequence[Request]) -> Iterator[DeviceExamination]:
        store.log({"event": "examine", "devices": len(requests)})
        with progress(len(requests), 0, quiet, "examining") as shown:
            campaigns = planned.campaigns
            items = [ExamineItem(r, {r.number: campaigns[r.number]} if campaigns else {}) for r in requests]
            limit_s = planned.config.run.device_limit_s
            watch = None if quiet else shown.partly
            for _, examination in guarded_in_parallel(
                client, examine_task, planned.config, items, EXAMINE_FAULTS, limit_s, watch=watch
            ):
                shown.advance(1)
                yield examination

    return examine(devices, planned.config.diagnosis, examine_devices)
