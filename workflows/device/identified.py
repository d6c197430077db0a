"""What was identified of one device: the columns of the results that apply, posterior draws, the words of the command.

| measurement | how | posterior |
|---|---|---|
| campaign of time records | :func:`pipeline.inference.identify.identify` | draws where the in-band path applies |
| sweeps, frequency responses | the given model by least squares | none |
| modal record | the paper's four thetas, and a least-squares fit | none |
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.model import Model
from pipeline.errors import UsageError
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.tones import ToneCampaign
from pipeline.identification.route import RouteResult, identify_modal
from pipeline.inference.identify import Identification
from pipeline.inference.identify import identify as identify_device
from pipeline.inference.modal.fit import ModalFit, fit_modal
from pipeline.performance.figure import by_table
from pipeline.plain import plain
from pipeline.quantities import QUANTITIES
from reports.decision import decide
from reports.limits import Limits
from reports.rules import Rule
from reports.words.noise import noise_words
from reports.words.numbers import rounded, sd_text, with_sd

from ..config import load_config
from ..shipped import shipped_limits_of
from .measured import Measured
from .tones import tone_columns, tone_text

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class IdentifiedDevice:
    """What was identified of one device; it prints as ``gyroscreen identify`` does.

    Parameters
    ----------
    name : of the device or of the modal record.
    columns : the columns of the devices table that apply, each in its unit.
    lines : the words of the command.
    draws : quantity -> (n,) posterior draws, in the unit of the quantity; empty without a posterior.
    """

    name: str
    columns: Mapping[str, Any]
    lines: tuple[str, ...]
    draws: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def status(self) -> str | None:
        """ "ok", "not_converged", "fit_failed" or "misfit"; ``None`` for a modal record."""
        return self.columns.get("status")

    @property
    def quantities(self) -> pd.DataFrame:
        """One row per quantity: value, sd, q05 and q95 (nan where not given) in its unit, and the unit."""
        import pandas as pd

        units = {quantity.name: quantity.unit for quantity in QUANTITIES}
        names = [name for name in self.columns if f"{name}_sd" in self.columns]
        numbers = {end or "value": [self._number(f"{name}{end and '_'}{end}") for name in names] for end in _ENDS}
        table = pd.DataFrame(numbers, index=pd.Index(names, name="quantity"), dtype=float)
        return table.assign(unit=[units.get(name, "") for name in names])

    @property
    def posterior(self) -> pd.DataFrame:
        """One row per draw, one column per quantity in its unit; no rows without a posterior."""
        import pandas as pd

        return pd.DataFrame(dict(self.draws)).dropna(axis="columns", how="all").rename_axis("draw")

    def to_dict(self) -> dict[str, Any]:
        """What ``gyroscreen identify --json`` prints."""
        found = plain(dict(self.columns))
        assert isinstance(found, dict)
        return found

    def _number(self, column: str) -> float:
        value = self.columns.get(column)
        return math.nan if value is None else float(value)

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        from ..learning.tables import html

        return html(self.lines[:1], (self.quantities,))


_ENDS = ("", "sd", "q05", "q95")


def identified(
    measured: Measured, model: Model | None = None, limits: Limits | None = None, seed: int = 1
) -> IdentifiedDevice:
    """Identify one device.

    Parameters
    ----------
    measured : a campaign, a campaign of sweeps and frequency responses, or a modal record.
    model : plant and effects; ``None`` chooses them by the measurement.
    limits : judge the device by these, which adds p_pass, verdict and failed_limits; ``None``: it is not judged, and the gate of
        the fit is that of the shipped limits.
    seed : of the posterior draws.

    Raises
    ------
    MeasurementError : nothing to fit, no noise, or too many bad samples.
    ConfigError : a model that does not apply to the records.
    UsageError : limits for a modal record, which is not judged.
    """
    if isinstance(measured, ToneCampaign):
        columns = tone_columns(measured, model)
        return IdentifiedDevice(measured.device_id, columns, tuple(tone_text(columns)))
    if isinstance(measured, ModalRecord):
        if limits is not None:
            raise UsageError(
                "a modal record is not judged, so limits do not apply",
                value=measured.name,
                allowed="--limits with a campaign or a record",
                next_step="leave out --limits",
            )
        route = identify_modal(measured)
        columns = modal_columns(route, fit_modal(route, measured.antialias))
        return IdentifiedDevice(measured.name, columns, tuple(_modal_text(measured.name, columns)))
    # Without limits for this kind of device, the gate judges the fit alone.
    judged_by = limits or shipped_limits_of(measured) or Limits(Rule(), ())
    gate = load_config(None).gate.gate(judged_by)
    result = identify_device(measured, model, gate=gate, seed=seed)
    columns = {**result.columns, **({"reference": result.reference} if measured.reference else {})}
    columns |= {} if limits is None else _decision(limits, result)
    lines = _text(result) + ([] if limits is None else [_verdict_text(columns)])
    return IdentifiedDevice(measured.device_id, columns, tuple(lines), result.draws)


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
        lines.append(
            f"  {len(unknown)} performance figures are unknown without {needed} (docs/explanation/performance.md)"
        )
    if bad := columns.get("bad_samples"):
        count = sum(one["samples"] for one in bad)
        lines.append(f"  {count} bad samples in {len(bad)} stretches were left out (gyroscreen check lists them)")
    for name, r in result.reference.items():
        lines.append(f"  reference {name}: {r['reference']:g} +- {r['reference_sd']:g}, z = {r['z']:+.2f}")
    return lines
