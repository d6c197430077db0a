"""Sweeps and frequency responses: the parameters of the given model, by least squares."""

from __future__ import annotations

from typing import Any

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.experiment.tones import ToneCampaign
from pipeline.inference.gate import Gate
from reports.words.numbers import with_sd

from ..learning import compare


def tone_columns(campaign: ToneCampaign, model: Model | None) -> dict[str, Any]:
    """The columns that apply: value and sd of each parameter, errors, and the status that the gate of a run gives."""
    answer = compare(campaign, model or DEFAULT_COMPARE_MODEL).answer
    columns: dict[str, Any] = {"device_id": campaign.device_id}
    if not answer.fit_ok:
        return columns | {"status": "fit_failed", "status_reason": answer.why or "the fit failed"}
    for name, (value, sd) in answer.parameters.items():
        columns[name], columns[f"{name}_sd"] = value, sd
    error = answer.error.get("fit")
    columns |= {"error": error, "relative_error": answer.relative_error.get("fit"), "status": "ok"}
    if error is not None and error > Gate().error_max:
        columns["status"] = "misfit"
        columns["status_reason"] = (
            f"the error of the fit is {error:.3g} noise levels, at most {Gate().error_max:g} is allowed"
        )
    return columns


def tone_text(columns: dict[str, Any]) -> list[str]:
    """The lines that ``identify`` prints."""
    lines = [f"device {columns['device_id']}: {columns['status']}"]
    if columns.get("status_reason"):
        lines.append(f"  {columns['status_reason']}")
    for name in columns:
        if f"{name}_sd" in columns:
            sd = columns[f"{name}_sd"]
            lines.append(f"  {name:20s} {with_sd(columns[name], sd)}")
    if columns.get("relative_error") is not None:
        error = "unknown (the noise is not measured)" if columns.get("error") is None else f"{columns['error']:.4f}"
        lines.append(f"  error {error}, relative error {columns['relative_error']:.3g}")
    return lines
