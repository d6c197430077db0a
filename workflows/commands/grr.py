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
from reports.gauge import GaugeData, gauge_study
from reports.grr.content import GaugeChart, GaugeContent, gauge_chart
from reports.limits import Limits, load_limits
from reports.limits_origin import origin_of_file, recorded_origin
from reports.words.gauge import gauge_lines

from ..screening.outcome import config_of_stored
from ..stored_page import stored_page

#: Quantities that are studied with or without limits.
_ALWAYS = ("theta_deg", "split_hz")
#: The page in the folder of the run, beside report.html.
PAGE = "grr.html"


def grr(run: str | None, results: Path, limits: Path | None, out: Path | None, json: bool) -> None:
    """See ``gyroscreen grr --help``."""
    folder = find_run(results, run)
    own = None if limits is None else load_limits(limits)
    run_id = folder.name.removeprefix("run=")

    def studied(tables: StoredRun) -> GaugeContent:
        config = config_of_stored(results, tables)
        recorded = recorded_origin(tables.manifest.provenance, bool(config.limits))
        origin = recorded if limits is None else origin_of_file(limits, "command line")
        return GaugeContent(run_id, gauge_charts(Devices(tables.devices), own or config.judged_by()), origin)

    found = with_run(results, run_id, studied)
    from reports.grr.page import render_gauge  # it loads matplotlib

    path = stored_page(render_gauge(found), results, run_id, PAGE, out)
    studies = [chart.study for chart in found.charts]
    if json:
        answer = {"studies": [asdict(one) for one in studies], "limits": found.limits.to_dict(), "page": str(path)}
        print(json_.dumps(to_plain(answer)))
    else:
        print(printable_lines("\n".join(gauge_lines(studies))))
        print(path)


def gauge_charts(devices: Devices, limits: Limits) -> tuple[GaugeChart, ...]:
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
    part, tester = devices.text("part").filled(devices.text("device_id")), devices.text("tester")
    codes: list[IntArray] = [part.codes, tester.codes, devices.text("session").codes]
    bounds = {limit.quantity: limit for limit in limits.limits}
    ok, found = devices.is_ok(), []
    for quantity in dict.fromkeys((*_ALWAYS, *bounds)):
        value = np.where(ok, devices.number(quantity), np.nan)
        if quantity in _ALWAYS or np.isfinite(value).any():
            data, axis = GaugeData(value, *codes), quantity in AXES
            study = gauge_study(quantity, data, bounds.get(quantity), axis)
            found.append(gauge_chart(study, data, part.words, tester.words, axis))
    return tuple(found)
