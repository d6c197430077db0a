"""gyroscreen grr."""

from __future__ import annotations

import json as json_
from dataclasses import asdict
from pathlib import Path

import numpy as np

from pipeline.arrays import IntArray
from pipeline.errors import UsageError, printable_lines
from pipeline.quantities import AXES
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.read import find_run
from reports.attribution.content import to_plain
from reports.devices import Devices
from reports.gauge import GaugeData, GaugeStudy, gauge_study
from reports.limits import Limits, load_limits
from reports.words.gauge import gauge_lines

from ..screening.outcome import config_of_stored

#: Quantities that are studied with or without limits.
_ALWAYS = ("theta_deg", "split_hz")


def grr(run: str | None, results: Path, limits: Path | None, json: bool) -> None:
    """See ``gyroscreen grr --help``."""
    folder = find_run(results, run)
    own = None if limits is None else load_limits(limits)

    def studied(tables: StoredRun) -> list[GaugeStudy]:
        return gauge_studies(Devices(tables.devices), own or config_of_stored(results, tables).judged_by())

    found = with_run(results, folder.name.removeprefix("run="), studied)
    if json:
        print(json_.dumps(to_plain({"studies": [asdict(one) for one in found]})))
    else:
        print(printable_lines("\n".join(gauge_lines(found))))


def gauge_studies(devices: Devices, limits: Limits) -> list[GaugeStudy]:
    """Gauge R&R of each limited quantity, of theta and of the split, from the campaigns with the status "ok".

    Raises
    ------
    UsageError : no campaign names its part, or as :func:`reports.gauge.gauge_study`.
    """
    if not devices.text("part").counts().keys() - {""}:
        raise UsageError(
            "no campaign of the run names its part, tester or session",
            allowed="[conditions] with part, tester, session in campaign.toml",
            next_step="measure devices repeatedly, name them there, and run the campaigns together",
        )
    part = devices.text("part").filled(devices.text("device_id")).codes
    codes: list[IntArray] = [part, devices.text("tester").codes, devices.text("session").codes]
    bounds = {limit.quantity: limit for limit in limits.limits}
    ok, found = devices.is_ok(), []
    for quantity in dict.fromkeys((*_ALWAYS, *bounds)):
        value = np.where(ok, devices.number(quantity), np.nan)
        if quantity in _ALWAYS or np.isfinite(value).any():
            found.append(gauge_study(quantity, GaugeData(value, *codes), bounds.get(quantity), quantity in AXES))
    return found
