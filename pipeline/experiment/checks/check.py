"""Look at a campaign before any fit, and say what to write into campaign.toml.

| kind | found from |
|---|---|
| polarity, swap, lag, hold | residues of the modes (2 x 2), phase of the response (one drive) |
| offset, drive_offset, clipping, dead, drive, converter, silence | the samples |
| hum | lines at multiples of 50 or 60 Hz |
| clock | the time column |
| rest | free ringing at the first sample |
| short | decay time of the modes |
| undecided | what could not be looked at, and why |

A "fault" must be mended or measured again, a "warning" costs accuracy, a "note" is good to know.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ..record import Campaign, Channels, Record
from . import levels as look
from .finding import Correction, Finding, Severity, channel_correction
from .hum import hum
from .response import Response, respond
from .single import single_lag
from .wiring import Wiring, wiring

#: A lag is found where it exceeds this many samples and five of its sd.
_LAG = 0.1
#: Above this relative error in the band, the response is not that of linear modes.
_POOR = 0.3
#: Initial motion, relative to the rms of the channel, below which a record is at rest.
_REST = 0.01


@dataclass(frozen=True)
class CheckReport:
    """Findings, worst first; ``levels`` of every sense channel in every record."""

    findings: tuple[Finding, ...]
    levels: tuple[look.Level, ...]

    @property
    def ok(self) -> bool:
        """Nothing found that must be mended."""
        return not any(finding.severity == "fault" for finding in self.findings)

    @property
    def correction(self) -> Correction:
        """All mends in one."""
        total = Correction()
        for finding in self.findings:
            total = total.joined(finding.correction)
        return total

    @property
    def toml(self) -> str:
        """The lines of campaign.toml to write or replace; empty where nothing there mends anything."""
        return self.correction.toml

    def of_kind(self, kind: str) -> tuple[Finding, ...]:
        """Findings of one kind."""
        return tuple(finding for finding in self.findings if finding.kind == kind)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        shown = [level.__dict__ for level in self.levels]
        return {"ok": self.ok, "findings": [f.to_dict() for f in self.findings], "levels": shown, "toml": self.toml}


def _shape(campaign: Campaign) -> tuple[int, int]:
    return campaign.records[0].drive_v.shape[1], campaign.records[0].sense_v.shape[1]


def _lag(campaign: Campaign, lag: float, sd: float, channel: str | None) -> list[Finding]:
    """A lag as whole samples, a wrong hold (half a sample), and what is left."""
    if abs(lag) < max(_LAG, 5.0 * sd):
        return []
    hold = campaign.instrument.hold
    # A zero-order hold is late by half a sample; the others are not.
    half = -0.5 if hold == "zoh" else 0.5
    # Of whole samples alone and whole samples with the other hold, the nearer; at first sight, the former.
    other_hold = abs(lag - half - round(lag - half)) < abs(lag - round(lag)) - max(_LAG, 5.0 * sd)
    whole = round(lag - half) if other_hold else round(lag)
    left = lag - whole - (half if other_hold else 0.0)
    found = []
    if other_hold:
        other, right = ("foh", "foh or bandlimited, not zoh") if hold == "zoh" else ("zoh", f"zoh, not {hold}")
        text = (
            f"the response is {'early' if half < 0.0 else 'late'} by half a sample: the hold is"
            f" {right} (the phase cannot tell a wrong hold from a delay of half a sample)"
        )
        correct = Correction(instrument={"hold": other})
        found.append(Finding("hold", "fault", text, None, channel, half, sd, "samples", correct))
    if whole:
        correct = channel_correction(campaign.channels, Channels(lag_samples=whole), *_shape(campaign))
        late = "late" if whole > 0 else "early"
        text = f"sense is {abs(whole)} sample(s) too {late} ({lag:+.3f} +- {sd:.3f} beyond hold and filter)"
        found.append(Finding("lag", "fault", text, None, channel, lag, sd, "samples", correct))
    if abs(left) > max(_LAG, 5.0 * sd):
        text = (
            f"{left:+.3f} samples of lag are left that neither whole samples nor the hold explain: a wrong"
            " or missing antialias, or the effects loop_delay, pickoff_pole"
        )
        found.append(Finding("lag", "warning", text, None, channel, left, sd, "samples"))
    return found


def _wired(campaign: Campaign, found: Wiring) -> list[Finding]:
    """Polarity and order as findings."""
    drives, senses = _shape(campaign)
    findings = []
    sure = f"({found.confidence_sd:.0f} sd)"
    for kind, signs in (("sense", found.sense_polarity), ("drive", found.drive_polarity)):
        if -1 not in signs:
            continue
        turned = ", ".join(f"{kind}{k + 1}" for k, sign in enumerate(signs) if sign < 0)
        more = Channels(sense_polarity=signs) if kind == "sense" else Channels(drive_polarity=signs)
        text = f"the up-down mode says that {turned} is turned round {sure}"
        if -1 in found.sense_polarity and -1 in found.drive_polarity:
            text += "; the same product of signs follows from turning the other sense and the other drive"
        correct = channel_correction(campaign.channels, more, drives, senses)
        findings.append(Finding("polarity", "fault", text, None, turned, found.confidence_sd, None, "sd", correct))
    if found.swapped:
        both = channel_correction(campaign.channels, Channels(sense_order=(2, 1)), drives, senses)
        text = (
            f"the two senses are swapped, or the two drives {sure}; which of them cannot be told: drive_order"
            " = [2, 1] in place of sense_order would do as well and gives theta the other sign, so look at the"
            " cables"
        )
        findings.append(Finding("swap", "fault", text, None, None, found.confidence_sd, None, "sd", both))
    elif found.swapped is None:
        text = "the rocking residues lie on neither diagonal: swapped channels cannot be told"
        findings.append(Finding("undecided", "note", text))
    return findings


def _rest(campaign: Campaign, response: Response) -> list[Finding]:
    """Free ringing at the first sample of records that are said to start at rest."""
    findings = []
    by_name = {record.name: record for record in campaign.records}
    for k, name in enumerate(response.records):
        record = by_name[name]
        if not record.at_rest:
            continue
        # Close modes share what rings; their sum is what the channel sees.
        amplitude = np.abs(response.start_v[k].sum(axis=0))
        sd = np.sqrt(np.sum(response.start_sd_v[k] ** 2, axis=0))
        size = record.sense_v.std(axis=0)
        moving = (amplitude > 8.0 * sd) & (amplitude > _REST * size)
        if np.any(moving):
            worst = int(np.argmax(np.where(moving, amplitude / size, 0.0)))
            channel, value, spread = f"sense{worst + 1}", float(amplitude[worst]), float(sd[worst])
            text = f"{channel} rings with {value:.3g} V at the first sample: the record is not from rest"
            correct = Correction(record={record.file or name: {"at_rest": False}})
            findings.append(Finding("rest", "fault", text, name, channel, value, spread, "V", correct))
    return findings


def _short(records: list[Record], response: Response | None) -> list[Finding]:
    """Records that end before the modes have shown their width."""
    findings = []
    for record in records:
        decay = float(np.max(1.0 / np.abs(response.poles.real))) if response else 0.0
        if record.duration_s < 0.5 * decay:
            lasts = record.duration_s
            text = f"lasts {lasts:.3g} s, the slowest mode decays in {decay:.3g} s: damping will be vague"
            findings.append(Finding("short", "warning", text, record.name, None, lasts, None, "s"))
        elif response is None and record.sense_v.shape[0] < 4000:
            text = f"has {record.sense_v.shape[0]} samples, too few for a response"
            findings.append(Finding("short", "warning", text, record.name, None, record.duration_s, None, "s"))
    return findings


def _collinear(records: list[Record]) -> bool:
    """The drives are one signal: no record tells them apart."""
    drive = np.concatenate([record.drive_v - record.drive_v.mean(axis=0) for record in records])
    gram = drive.T @ drive
    scale = np.sqrt(np.diag(gram))
    return bool(np.all(scale > 0.0) and np.linalg.eigvalsh(gram / np.outer(scale, scale))[0] < 1e-6)


def _deaf_drives(response: Response) -> list[Finding]:
    """Drives that move nothing."""
    total, sd = response.summed(list(range(response.poles.size)))
    each = np.max(np.abs(response.residues), axis=(0, 1))
    found = []
    for j in range(total.shape[1]):
        lost = bool(np.all(np.abs(total[:, j]) < 4.0 * sd[:, j])) and each[j] < 0.01 * each.max()
        if lost or each[j] < 1e-3 * each.max():
            text = f"drive{j + 1} is commanded but moves nothing: not connected, or the wrong column"
            found.append(Finding("drive", "fault", text, None, f"drive{j + 1}", float(each[j]), None, "1/s"))
    return found


def _dynamic(campaign: Campaign, driven: list[Record]) -> list[Finding]:
    """What the response of the driven records says."""
    drives, senses = _shape(campaign)
    if drives == 1:
        record = max(driven, key=lambda r: r.duration_s)
        findings = []
        lags = {f"sense{k + 1}": single_lag(record, k, campaign.instrument) for k in range(senses)}
        told = {name: lag for name, lag in lags.items() if lag is not None}
        for name, (lag, sd) in told.items():
            findings += _lag(campaign, lag, sd, name if len(told) > 1 else None)
        if len(told) < senses:
            text = "the phase does not tell a lag: no response on both sides of a resonance"
            findings.append(Finding("undecided", "note", text))
        return findings + _short(driven, None)
    if _collinear(driven):
        text = "the drives are one and the same signal: what each does cannot be told apart"
        return [Finding("drive", "fault", text)]
    response = respond(driven, 3) if (drives, senses) == (2, 2) else None
    if response is None or response.relative_error > _POOR:
        why = "no band with three modes" if response is None else f"misfit {response.relative_error:.2f} in band"
        text = f"polarity, order, lag and rest are not looked at: {why}"
        return [Finding("undecided", "note", text), *_short(driven, None)]
    deaf = _deaf_drives(response)
    if deaf:
        return deaf
    found = wiring(response, campaign.instrument)
    if isinstance(found, str):
        return [Finding("undecided", "note", f"polarity, order and lag: {found}"), *_short(driven, response)]
    wired = [*_wired(campaign, found), *_lag(campaign, found.lag_samples, found.lag_sd, None)]
    # A lag looks like motion at the start.
    rest = _rest(campaign, response) if abs(found.lag_samples) < 0.6 else []
    return [*wired, *rest, *_short(driven, response)]


def check(campaign: Campaign) -> CheckReport:
    """Everything in the table above that applies to ``campaign``.

    No fit of a device model is made and nothing is changed; the mends go to campaign.toml.
    """
    found = [look.level(record, k) for record in campaign.records for k in range(record.sense_v.shape[1])]
    by_record = {r.name: [level for level in found if level.record == r.name] for r in campaign.records}
    findings: list[Finding] = [*look.drive_offsets(campaign), *look.roles(campaign)]
    silent_or_dead: list[Finding] = []
    for record in campaign.records:
        rows = by_record[record.name]
        for row in rows:
            others = max((other.rms_v for other in rows if other is not row), default=0.0)
            silent_or_dead += look.dead(record, row, others)
            findings += look.offset(record, row)
            findings += look.clipping(record, row, campaign.instrument.adc)
    findings += silent_or_dead
    findings += look.converter(campaign, found)
    findings += look.clocks(campaign)
    findings += hum(campaign)
    driven = [record for record in campaign.records if look.is_driven(record)]
    if driven and not silent_or_dead:
        # The matrices are small: threads would wait for each other longer than they work.
        with threadpool_limits(limits=1, user_api="blas"):
            findings += _dynamic(campaign, [look.without_bias(record, campaign.instrument) for record in driven])
    rank: dict[Severity, int] = {"fault": 0, "warning": 1, "note": 2}
    return CheckReport(tuple(sorted(findings, key=lambda finding: rank[finding.severity])), tuple(found))
