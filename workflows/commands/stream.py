"""gyroscreen identify --stream."""

from __future__ import annotations

import json as json_
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.errors import MeasurementError, UsageError
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.record import Campaign
from pipeline.inference.screening.stream import StreamSettings
from pipeline.plain import plain
from reports.limits import DEFAULT_LIMITS, load_limits
from reports.sequential import check_rule
from reports.words.numbers import with_sd

from ..streaming.growing import record_blocks
from ..streaming.stream import StreamStep, bench_of, follow
from .identify import require_identified

_HEAD = "  time s   theta deg            split Hz                 P(conform)  verdict    lattice: theta, split"


def stream(
    source: Path,
    json: bool,
    campaign: Path | None = None,
    sigma_v: float | None = None,
    limits: Path | None = None,
    every_s: float = 0.1,
    order: int = 40,
    patience_s: float = 2.0,
    decide: bool = False,
) -> None:
    """Identify a record while it grows.

    Parameters
    ----------
    source : file, "-" for standard input, or a campaign folder (its first record to fit).
    json : one object at the end instead of lines.
    campaign : folder whose campaign.toml gives instrument, noise and demodulation.
    sigma_v : noise of both senses [V]; else from the campaign's silent record, else from the silence before the drive.
    limits : limits and rule (TOML); default: the shipped ones.
    every_s : time between estimates [s].
    order : of the lattice.
    patience_s : a file that has not grown for this time has ended [s].
    decide : stop at the first verdict.
    """
    for name, value in (
        ("--every", every_s),
        ("--patience", patience_s),
        ("--sigma-v", 1.0 if sigma_v is None else sigma_v),
    ):
        if not value > 0.0:
            raise UsageError(f"{name} must be positive", value=value, allowed="above 0", next_step="correct it")
    if not 10 <= order <= 80:
        raise UsageError("invalid order of the lattice", value=order, allowed="10 to 80", next_step="use 40")
    folder = source if campaign is None and source.is_dir() else campaign
    known = None if folder is None else read_measurement(folder)
    if known is not None and not isinstance(known, Campaign):
        raise UsageError(
            "--campaign has no records in the time domain", value=str(campaign), allowed="a campaign folder"
        )
    sigma = None if sigma_v is None else (sigma_v, sigma_v)
    bench = bench_of(known, StreamSettings(order=order, every_s=every_s, sigma_v=sigma))
    judged_by = DEFAULT_LIMITS if limits is None else load_limits(limits)
    check_rule(judged_by)
    if isinstance(known, Campaign) and source.is_dir():
        source = _first_fit(known, source)
    text = sys.stdin if str(source) == "-" else source
    blocks = record_blocks(text, None if bench.instrument is None else bench.instrument.sample_rate_hz, patience_s)
    last: StreamStep | None = None
    decided: StreamStep | None = None
    found: list[dict[str, Any]] = []
    for last in follow(blocks, bench, judged_by):
        if not json and not found:
            print(_HEAD)
        found.append(_columns(last))
        if not json:
            print(_line(last), flush=True)
        if decided is None and last.verdict != "undecided":
            decided = last
            if decide:
                break
    if last is None:
        raise MeasurementError(
            "the record ended before the drive started",
            value=str(source),
            allowed="a record in which both drives act",
            next_step="check that the file is being written, or raise --patience",
        )
    if decided is None and last.verdict_at_end != "undecided":
        decided = replace(last, verdict=last.verdict_at_end)
    verdict = {
        "verdict": "undecided" if decided is None else decided.verdict,
        "decided_after_s": None if decided is None else decided.snapshot.duration_s,
    }
    if json:
        print(json_.dumps({**found[-1], **verdict, "steps": found}))
    elif decided is None:
        print(f"undecided after {last.snapshot.duration_s:.4g} s of drive")
    else:
        print(f"{decided.verdict} after {decided.snapshot.duration_s:.4g} s of drive")
    require_identified(last.snapshot.estimate.status, last.snapshot.estimate.reason, source)


def _first_fit(campaign: Campaign, folder: Path) -> Path:
    files = [record.file for record in campaign.with_role("fit") if record.file is not None]
    if not files:
        raise UsageError("the campaign has no record to fit", value=str(folder), allowed='a record with role = "fit"')
    return folder / files[0]


def _columns(step: StreamStep) -> dict[str, Any]:
    s = step.snapshot
    estimate = s.estimate
    values: dict[str, Any] = {"time_s": s.duration_s, "status": estimate.status, "status_reason": estimate.reason}
    values |= {name: plain(value) for name, value in estimate.columns.items()}
    # A test in seconds cannot wait for the scores of effects; ``identify`` of the whole record makes them.
    values |= {"p_pass": plain(step.p_pass), "verdict": step.verdict, "effects_scored": False}
    if step.route is not None:
        values |= {"lattice_theta_deg": step.route.axes.mean_deg, "lattice_split_hz": step.route.arx_split_hz}
    return values


def _line(step: StreamStep) -> str:
    s = step.snapshot
    c = s.estimate.columns
    if "theta_deg" in c:
        theta = with_sd(c["theta_deg"], c["theta_deg_sd"])
        split = with_sd(c["split_hz"], c["split_hz_sd"])
        judged = f"{theta:20s} {split:24s} {step.p_pass:10.4f}  {step.verdict:9s}"
    else:
        judged = f"{s.estimate.status}: {s.estimate.reason}"
    route = step.route
    lattice = "" if route is None else f"  {route.axes.mean_deg:.2f}, {route.arx_split_hz:.4f}"
    return f"{s.duration_s:8.3f}   {judged}{lattice}"
