"""gyroscreen identify, check."""

from __future__ import annotations

import json as json_
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.device.model import load_model
from pipeline.errors import NegativeError, UsageError, printable_lines
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.checks.check import CheckReport
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.files.readers import existing
from pipeline.experiment.record import Campaign
from pipeline.experiment.tones import ToneCampaign
from pipeline.identification.route import RouteResult, identify_modal
from pipeline.inference.identify import Identification
from pipeline.inference.identify import identify as identify_device
from pipeline.inference.modal.fit import ModalFit, fit_modal
from pipeline.performance.figure import by_table
from pipeline.plain import plain
from pipeline.quantities import QUANTITIES
from reports.decision import decide
from reports.limits import Limits, load_limits
from reports.limits_origin import origin_of_file
from reports.rules import Rule
from reports.words.noise import noise_words
from reports.words.numbers import rounded, sd_text, with_sd

from ..config import load_config
from ..shipped import shipped_limits_of
from .identify_tones import tone_columns, tone_text


def identify(measurement: Path, model: Path | None, limits: Path | None, json: bool) -> None:
    """See ``gyroscreen identify --help``."""
    own = None if limits is None else load_limits(limits)
    found = with_its_campaign(measurement)
    if isinstance(found, ToneCampaign):
        columns = tone_columns(found, None if model is None else load_model(model))
        lines = tone_text(columns)
    elif isinstance(found, ModalRecord):
        if limits is not None:
            raise UsageError(
                "a modal record is not judged, so limits do not apply",
                value=str(measurement),
                allowed="--limits with a campaign or a record",
                next_step="leave out --limits",
            )
        route = identify_modal(found)
        columns = modal_columns(route, fit_modal(route, found.antialias))
        lines = _modal_text(found.name, columns)
    else:
        # Without limits for this kind of device, the gate judges the fit alone.
        judged_by = own or shipped_limits_of(found) or Limits(Rule(), ())
        gate = load_config(None).gate.gate(judged_by)
        result = identify_device(found, None if model is None else load_model(model), gate=gate)
        columns = {**result.columns, **({"reference": result.reference} if found.reference else {})}
        if own is not None and limits is not None:
            columns |= _decision(own, result) | {"limits": origin_of_file(limits, "command line").to_dict()}
        lines = _text(result) + ([] if own is None else [_verdict_text(columns)])
    print(json_.dumps(plain(columns)) if json else printable_lines("\n".join(lines)))
    require_identified(columns.get("status"), columns.get("status_reason"), measurement)


def _decision(limits: Limits, result: Identification) -> dict[str, Any]:
    """p_pass, verdict and failed_limits by the user's limits, as in a run."""
    draws = {q: result.draws.get(q, np.full(1, np.nan))[None] for q in limits.quantities}
    found = decide(limits, draws, [result.columns["status"]])
    return {
        "p_pass": float(found.p_pass[0]),
        "verdict": found.verdict[0],
        "failed_limits": found.failed_limits[0] or None,
    }


def _verdict_text(columns: dict[str, Any]) -> str:
    known = math.isfinite(columns["p_pass"])
    share = f", P(conform) {columns['p_pass']:.3f}" if known else ""
    failed = f", outside: {columns['failed_limits']}" if columns["failed_limits"] else ""
    return f"  verdict by the given limits: {columns['verdict']}{share}{failed}"


def require_identified(status: str | None, reason: str | None, measurement: Path) -> None:
    """Raise NegativeError if the status of a device says that its numbers cannot be used."""
    if status not in ("fit_failed", "misfit"):
        return
    why = f" ({reason})" if reason else ""
    searched = f"gyroscreen diagnose {measurement} searches for the missing effect"
    raise NegativeError(
        f"the device has the status {status}{why}",
        allowed="ok or not_converged",
        next_step=searched if status == "misfit" else f"gyroscreen check {measurement}",
    )


def with_its_campaign(measurement: Path) -> Campaign | ModalRecord | ToneCampaign:
    """The measurement; a single record is read with the campaign that lists it, if there is one.

    The campaign.toml in the folder of the record then gives the instrument and the silent records.
    """
    existing(measurement)
    beside = measurement.parent / "campaign.toml"
    if measurement.suffix != ".toml" and measurement.is_file() and beside.is_file():
        campaign = read_measurement(beside)
        if not isinstance(campaign, Campaign):
            return campaign if measurement.name in _files(campaign) else read_measurement(measurement)
        listed = [r for r in campaign.records if r.file is not None and Path(r.file).name == measurement.name]
        if listed:
            silent = tuple(r for r in campaign.with_role("noise") if r is not listed[0])
            return replace(campaign, records=(*silent, replace(listed[0], role="fit")))
    return read_measurement(measurement)


def _files(campaign: ModalRecord | ToneCampaign) -> set[str]:
    """Names of the files of a campaign of sweeps and frequency responses."""
    records = campaign.records if isinstance(campaign, ToneCampaign) else ()
    return {Path(record.file).name for record in records if record.file is not None}


def modal_columns(route: RouteResult, fit: ModalFit) -> dict[str, Any]:
    """The columns that apply to a modal record: the paper's four thetas, and a least-squares fit of plant "gyro"."""
    axes = route.axes
    columns: dict[str, Any] = {
        "theta_u1_deg": axes.theta_u1_deg,
        "theta_v1_deg": axes.theta_v1_deg,
        "theta_u2_deg": axes.theta_u2_deg,
        "theta_v2_deg": axes.theta_v2_deg,
        "split_hz": route.arx_split_hz,
        "relative_error": fit.relative_error,
    }
    for name, value in fit.values.items():
        columns[name], columns[f"{name}_sd"] = value, fit.sd[name]
    for i in range(3):
        columns[f"f{i + 1}_hz"], columns[f"zeta{i + 1}"] = float(route.f_hz[i]), float(route.zeta[i])
    return columns


def _modal_text(name: str, c: dict[str, Any]) -> list[str]:
    four = ", ".join(f"{c[f'theta_{k}_deg']:.2f}" for k in ("u1", "v1", "u2", "v2"))
    return [
        f"modal record {name}",
        f"theta       {with_sd(c['theta_deg'], c['theta_deg_sd'])} deg, least squares over all modes",
        f"four thetas {four} deg (u1, v1, u2, v2)",
        f"split       {c['split_hz']:.4g} Hz",
        f"modes       {c['f1_hz']:.2f}, {c['f2_hz']:.2f}, {c['f3_hz']:.2f} Hz",
        f"imbalance   sense {c['sense_imbalance']:.4f}, drive {c['drive_imbalance']:.4f}",
        f"model error {100 * c['relative_error']:.1f} % of the residues at resonance",
    ]


def _text(result: Identification) -> list[str]:
    columns = result.columns
    lines = [f"device {columns['device_id']}: {columns['status']}"]
    if columns.get("status_reason"):
        lines.append(f"  {columns['status_reason']}")
    units = {q.name: q.unit for q in QUANTITIES}
    shown = [q for q in columns if f"{q}_sd" in columns]
    for name in shown:
        unit = "" if units.get(name, "1") == "1" else f" {units[name]}"
        sd, low, high = (columns.get(f"{name}_{end}") for end in ("sd", "q05", "q95"))
        span = "" if low is None or high is None else f"   90 %: {rounded(low, sd)} to {rounded(high, sd)}"
        bound = columns.get(f"{name}_bias_bound")
        bias = "" if bound is None else f"   undetected bias: at most {sd_text(bound)}"
        lines.append(f"  {name:26s} {with_sd(columns[name], sd)}{unit}{span}{bias}")
    error = "unknown (no silent record and no repeats)" if columns.get("error") is None else f"{columns['error']:.4f}"
    if columns.get("relative_error") is not None:
        lines.append(f"  error {error}, relative error {columns['relative_error']:.3g}")
    if noise := noise_words(columns):
        lines.append(f"  noise: {noise}")
    if not columns.get("effects_scored", True) and columns["status"] != "fit_failed":
        lines.append("  effects of the library were not scored here: run gyroscreen diagnose")
    if unknown := columns.get("figures_unknown"):
        needed = by_table(place for places in unknown.values() for place in places)
        lines.append(f"  {len(unknown)} performance figures are unknown without {needed} (docs/performance.md)")
    if bad := columns.get("bad_samples"):
        count = sum(one["samples"] for one in bad)
        lines.append(f"  {count} bad samples in {len(bad)} stretches were left out (gyroscreen check lists them)")
    for name, r in result.reference.items():
        lines.append(f"  reference {name}: {r['reference']:g} +- {r['reference_sd']:g}, z = {r['z']:+.2f}")
    return lines


def check(campaign: Path, json: bool) -> None:
    """See ``gyroscreen check --help``."""
    from pipeline.experiment.checks.check import check as check_measurement
    from pipeline.experiment.checks.domains import check_all

    found = read_measurement(campaign)
    if isinstance(found, ModalRecord):
        raise UsageError("a modal record has no samples to check", value=str(campaign), allowed="a campaign or record")
    report = check_all(found) if isinstance(found, ToneCampaign) else check_measurement(found)
    if json:
        print(json_.dumps(report.to_dict()))
        return
    print(printable_lines("\n".join(_check_text(report))))


def _check_text(report: CheckReport) -> list[str]:
    lines = ["levels      record                channel   offset V      rms V     peak V    floor V"]
    for level in report.levels:
        floor = "" if level.floor_v is None else f"{level.floor_v:10.3g}"
        numbers = f"{level.offset_v:10.2g} {level.rms_v:10.4g} {level.peak_v:10.4g} {floor}"
        lines.append(f"            {level.record:20s}  {level.channel:8s} {numbers}")
    for finding in report.findings:
        where = " ".join(part for part in (finding.record, finding.channel) if part)
        lines.append(f"{finding.severity + ':':11s} {where + ': ' if where else ''}{finding.text}")
    if not report.findings:
        lines.append("no problem found")
    if report.toml:
        lines += ["", "# correction in campaign.toml:", report.toml.rstrip()]
    return lines
