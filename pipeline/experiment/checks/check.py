"""Test a campaign before any fit, and state what to write into campaign.toml.

| kind | found from |
|---|---|
| polarity, swap, lag, hold, pickoff | residues of the modes (2 x 2), phase of the response (one drive) |
| bad_samples | the prediction of each sample from its neighbours and the drives |
| offset, drive_offset, clipping, dead, drive, converter, silence | the samples |
| hum | lines at multiples of 50 or 60 Hz |
| clock | the time column |
| rest | free motion at the first sample |
| short | decay time of the modes |
| decay | frequency and damping of the pieces of a free decay, without a model |
| undecided | a test that could not be done, and why |

A "fault" must be corrected or measured again, a "warning" costs accuracy, a "note" is for information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from ..bad_samples import marked
from ..record import Campaign, Record
from .bad import bad_samples
from .clock import clocks
from .decays import decays
from .drives import drive_offsets, is_driven, roles, unused_drives, without_bias
from .finding import Correction, Finding, Severity
from .hum import hum
from .levels import Level, clipping, converter, dead, drive_clipping, level, offset
from .response import respond
from .response_findings import (
    channel_counts,
    collinear_drives,
    ineffective_drives,
    lag_findings,
    rest_findings,
    short_findings,
    wiring_findings,
)
from .single import common_lag
from .wiring import wiring

#: Above this relative error in the band, the response is not that of three linear modes.
_POOR = 0.3


@dataclass(frozen=True)
class CheckReport:
    """Findings, worst first, and the level of every sense channel in every record."""

    findings: tuple[Finding, ...]
    levels: tuple[Level, ...]

    @property
    def ok(self) -> bool:
        """Whether there is no fault."""
        return not any(finding.severity == "fault" for finding in self.findings)

    @property
    def correction(self) -> Correction:
        """All corrections in one."""
        total = Correction()
        for finding in self.findings:
            total = total.joined(finding.correction)
        return total

    @property
    def toml(self) -> str:
        """The lines of campaign.toml to write or replace; empty where no key corrects anything."""
        return self.correction.toml

    def of_kind(self, kind: str) -> tuple[Finding, ...]:
        """Findings of one kind."""
        return tuple(finding for finding in self.findings if finding.kind == kind)

    def to_dict(self) -> dict[str, Any]:
        """The report as a JSON object."""
        shown = [level.__dict__ for level in self.levels]
        return {"ok": self.ok, "findings": [f.to_dict() for f in self.findings], "levels": shown, "toml": self.toml}


def _single_drive(campaign: Campaign, driven: list[Record], senses: int) -> list[Finding]:
    """Lag and hold of a device with one drive."""
    findings = []
    lags = {f"sense{k + 1}": common_lag(driven, k, campaign.instrument) for k in range(senses)}
    measured = {name: lag for name, lag in lags.items() if lag is not None}
    for name, (lag, sd) in measured.items():
        findings += lag_findings(campaign, lag, sd, name if len(measured) > 1 else None)
    if len(measured) < senses:
        missing = ", ".join(name for name, lag in lags.items() if lag is None)
        text = (
            f"Lag and hold of {missing} could not be tested: there is no coherent response on both sides of a resonance, or"
            " records disagree, as where several modes respond. Drive the device over a band that extends at least 10 % below"
            " and above its resonance."
        )
        findings.append(Finding("undecided", "note", text))
    return findings + short_findings(driven, None)


def _untested(tests: str, why: str) -> Finding:
    return Finding("undecided", "note", f"{tests} could not be tested: {why}.")


def _response_findings(campaign: Campaign, driven: list[Record]) -> list[Finding]:
    """Findings from the response of the driven records, whose drives are free of the bias."""
    drives, senses = channel_counts(campaign)
    if drives == 1:
        return _single_drive(campaign, driven, senses)
    if unused := unused_drives(driven):
        why = f"{', '.join(f'drive{k + 1}' for k in unused)} never varies"
        return [_untested("Polarity, channel order, lag and rest", why)]
    if collinear := collinear_drives(driven):
        return collinear
    response = respond(driven, 3) if (drives, senses) == (2, 2) else None
    if response is None or response.relative_error > _POOR:
        if (drives, senses) != (2, 2):
            why = f"the tests need two drives and two senses, and the records have {drives} and {senses}"
        elif response is None:
            why = "no driven band of the records determines three modes. Sweep a band that contains all three modes"
        else:
            why = (
                f"three linear modes leave a relative error of {response.relative_error:.2f} in the driven band (limit"
                f" {_POOR:g}). Check that the drive and sense columns belong to the same run"
            )
        return [_untested("Polarity, channel order, lag and rest", why), *short_findings(driven, None)]
    if not campaign.frame.updown:
        why = "the layout senses no up-down mode, whose residues these tests need"
        return [_untested("Polarity, channel order and lag", why), *short_findings(driven, response)]
    if ineffective := ineffective_drives(response):
        return ineffective
    found = wiring(response, campaign.instrument)
    if isinstance(found, str):
        return [_untested("Polarity, channel order and lag", found), *short_findings(driven, response)]
    wired = [*wiring_findings(campaign, found), *lag_findings(campaign, found.lag_samples, found.lag_sd, None)]
    # A lag resembles motion at the start, so the test for rest needs a record without one.
    rest = rest_findings(campaign, response) if abs(found.lag_samples) < 0.6 else []
    return [*wired, *rest, *short_findings(driven, response)]


def check(campaign: Campaign) -> CheckReport:
    """All tests in the table above that apply to ``campaign``.

    No device model is fitted and nothing is changed; ``CheckReport.toml`` holds the corrections for campaign.toml.
    """
    found = [level(record, k) for record in campaign.records for k in range(record.sense_v.shape[1])]
    by_record = {r.name: [row for row in found if row.record == r.name] for r in campaign.records}
    findings: list[Finding] = [*drive_offsets(campaign), *roles(campaign), *decays(campaign)]
    dead_channels: list[Finding] = []
    for record in campaign.records:
        rows = by_record[record.name]
        for row in rows:
            others = max((other.rms_v for other in rows if other is not row), default=0.0)
            dead_channels += dead(record, row, others)
            findings += offset(record, row)
            findings += clipping(record, row, campaign.instrument.adc)
        findings += drive_clipping(record)
    findings += dead_channels
    findings += converter(campaign, found)
    marked_records = [marked(record, campaign.instrument.adc) for record in campaign.records]
    for record in marked_records:
        findings += bad_samples(record)
    findings += clocks(campaign)
    findings += hum(campaign)
    # The response is that of the good samples; levels, clipping and dead channels are those of the samples as they are.
    driven = [record for record in marked_records if is_driven(record)]
    if driven and not dead_channels:
        # The matrices are small: more BLAS threads would only wait for each other.
        with threadpool_limits(limits=1, user_api="blas"):
            findings += _response_findings(campaign, [without_bias(r, campaign.instrument) for r in driven])
    return CheckReport(worst_first(findings), tuple(found))


def worst_first(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Faults, then warnings, then notes."""
    rank: dict[Severity, int] = {"fault": 0, "warning": 1, "note": 2}
    return tuple(sorted(findings, key=lambda finding: rank[finding.severity]))
