"""What was checked of one campaign before any fit; the words of the command, and tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pipeline.errors import UsageError
from pipeline.experiment.checks.check import CheckReport
from pipeline.experiment.checks.check import check as check_measurement
from pipeline.experiment.checks.domains import check_all
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.tones import ToneCampaign

from .measured import Measured

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class CheckedCampaign:
    """The findings of ``gyroscreen check``; it prints as the command does."""

    report: CheckReport

    @property
    def ok(self) -> bool:
        """Whether there is no fault."""
        return self.report.ok

    @property
    def findings(self) -> pd.DataFrame:
        """One row per finding, worst first: kind, severity, record, channel, text, value, sd and unit."""
        import pandas as pd

        names = ("kind", "severity", "record", "channel", "text", "value", "sd", "unit")
        rows = [{name: getattr(found, name) for name in names} for found in self.report.findings]
        return pd.DataFrame(rows, columns=list(names)).astype({"value": float, "sd": float})

    @property
    def levels(self) -> pd.DataFrame:
        """One row per record and sense channel: offset, rms, peak and noise floor [V]."""
        import pandas as pd

        return pd.DataFrame([level.__dict__ for level in self.report.levels])

    @property
    def toml(self) -> str:
        """The lines of campaign.toml to write or replace; empty where no key corrects anything."""
        return self.report.toml

    def to_dict(self) -> dict[str, Any]:
        """What ``gyroscreen check --json`` prints."""
        return self.report.to_dict()

    def __str__(self) -> str:
        return "\n".join(_check_text(self.report))

    def __repr__(self) -> str:
        return str(self)


def checked(measured: Measured) -> CheckedCampaign:
    """Check a campaign before any fit: polarity, swapped channels, lag, offset, clipping, hum, clock.

    Raises
    ------
    UsageError : a modal record, which has no samples.
    """
    if isinstance(measured, ModalRecord):
        raise UsageError(
            "a modal record has no samples to check",
            value=measured.name,
            allowed="a campaign or record",
            next_step="check the campaign it was identified from",
        )
    return CheckedCampaign(check_all(measured) if isinstance(measured, ToneCampaign) else check_measurement(measured))


def _check_text(report: CheckReport) -> list[str]:
    wide = max(20, *(len(level.record) for level in report.levels))
    lines = [f"levels      {'record':{wide}s}  channel   offset V      rms V     peak V    floor V"]
    for level in report.levels:
        floor = "" if level.floor_v is None else f"{level.floor_v:10.3g}"
        numbers = f"{level.offset_v:10.2g} {level.rms_v:10.4g} {level.peak_v:10.4g} {floor}"
        lines.append(f"            {level.record:{wide}s}  {level.channel:8s} {numbers}")
    for finding in report.findings:
        where = " ".join(part for part in (finding.record, finding.channel) if part)
        lines.append(f"{finding.severity + ':':11s} {where + ': ' if where else ''}{finding.text}")
    if not report.findings:
        lines.append("no problem found")
    if report.toml:
        lines += ["", "# correction in campaign.toml:", report.toml.rstrip()]
    return lines
