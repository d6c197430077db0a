"""Findings from the response of the driven records: wiring, lag, hold, rest, unused drives, record length.

Lags are in samples, residues in 1/s, amplitudes in volts.
"""

from __future__ import annotations

import numpy as np

from ..record import Campaign, Channels, Record
from .finding import Correction, Finding, channel_correction
from .response import Response
from .wiring import DOMINANCE, Wiring

#: A lag is reported where it exceeds this many samples and five of its sd.
_LAG = 0.1
#: Initial motion, relative to the rms of the channel, below which a record counts as at rest.
_REST = 0.01
#: Records with fewer samples are reported as short where the response could not be fitted.
_FEW_SAMPLES = 4000


def channel_counts(campaign: Campaign) -> tuple[int, int]:
    """Numbers of drives and senses."""
    return campaign.records[0].drive_v.shape[1], campaign.records[0].sense_v.shape[1]


def lag_findings(campaign: Campaign, lag: float, sd: float, channel: str | None) -> list[Finding]:
    """A measured lag and its sd [samples], split into a wrong hold (half a sample), whole samples, and the remainder."""
    if abs(lag) < max(_LAG, 5.0 * sd):
        return []
    hold = campaign.instrument.hold
    # A zero-order hold delays by half a sample; the other holds do not.
    half = -0.5 if hold == "zoh" else 0.5
    # The hold is wrong if whole samples and half a sample fit the lag significantly better than whole samples alone.
    other_hold = abs(lag - half - round(lag - half)) < abs(lag - round(lag)) - max(_LAG, 5.0 * sd)
    whole = round(lag - half) if other_hold else round(lag)
    left = lag - whole - (half if other_hold else 0.0)
    who = channel or "The sense"
    found = []
    if other_hold:
        other = "foh" if hold == "zoh" else "zoh"
        correction = Correction(instrument={"hold": other})
        also = ' (or hold = "bandlimited", for a DAC with a reconstruction filter)' if hold == "zoh" else ""
        text = (
            f"{who} is {'early' if half < 0.0 else 'late'} by half a sample ({lag - whole:+.3f} +- {sd:.2g} samples beyond"
            f' whole samples), as with another hold than the declared "{hold}". Check the DAC hold: {correction.advice}'
            f"{also}. A delay of half a sample has the same phase."
        )
        found.append(Finding("hold", "fault", text, None, channel, half, sd, "samples", correction))
    if whole:
        correction = channel_correction(campaign.channels, Channels(lag_samples=whole), *channel_counts(campaign))
        late = "late" if whole > 0 else "early"
        text = (
            f"{who} is {abs(whole)} sample{'s' if abs(whole) > 1 else ''} {late} (measured lag {lag:+.3f} +- {sd:.2g}"
            f" samples beyond the declared hold and filter): {correction.advice}."
        )
        found.append(Finding("lag", "fault", text, None, channel, lag, sd, "samples", correction))
    if abs(left) > max(_LAG, 5.0 * sd):
        text = (
            f"{who} has a lag of {left:+.3f} +- {sd:.2g} samples that neither whole samples nor the hold explain. Check"
            " that antialias under [instrument] is the filter that was used; if it is, add the effect loop_delay or"
            " pickoff_pole to the model."
        )
        found.append(Finding("lag", "warning", text, None, channel, left, sd, "samples"))
    return found


def _pickoff_findings(campaign: Campaign, found: Wiring) -> list[Finding]:
    """A pick-off that is not the declared one."""
    declared = campaign.instrument.pickoff
    if found.pickoff == declared:
        return []
    correction = Correction(device={"pickoff": found.pickoff})
    text = (
        f"All modes have the phase of {found.pickoff}, a quarter of a period from that of {declared}, which is declared. A lag"
        f" would turn modes of different frequencies by different angles; it is excluded by {found.pickoff_sd:.0f} sd. If the"
        f" pick-offs sense {found.pickoff}, {correction.advice}; if not, look for a phase shift of 90 deg in the read-out."
    )
    return [Finding("pickoff", "fault", text, None, None, found.pickoff_sd, None, "sd", correction)]


def wiring_findings(campaign: Campaign, found: Wiring) -> list[Finding]:
    """A pick-off of another kind, inverted and swapped channels."""
    drives, senses = channel_counts(campaign)
    findings = _pickoff_findings(campaign, found)
    sure = f"weakest residue {found.confidence_sd:.0f} sd from zero"
    for kind, signs in (("sense", found.sense_polarity), ("drive", found.drive_polarity)):
        if -1 not in signs:
            continue
        names = [f"{kind}{k + 1}" for k, sign in enumerate(signs) if sign < 0]
        inverted = ", ".join(names)
        more = Channels(sense_polarity=signs) if kind == "sense" else Channels(drive_polarity=signs)
        correction = channel_correction(campaign.channels, more, drives, senses)
        text = (
            f"{inverted} {'is' if len(names) == 1 else 'are'} inverted: the residues of the up-down mode do not all have"
            f" the same sign ({sure}). Reverse the leads, or {correction.advice}."
        )
        if -1 in found.sense_polarity and -1 in found.drive_polarity:
            text += " Inverting the other sense and the other drive instead describes the same linear device."
        findings.append(Finding("polarity", "fault", text, None, inverted, found.confidence_sd, None, "sd", correction))
    if found.swapped:
        senses_swapped = channel_correction(campaign.channels, Channels(sense_order=(2, 1)), drives, senses)
        drives_swapped = channel_correction(campaign.channels, Channels(drive_order=(2, 1)), drives, senses)
        text = (
            "The two senses or the two drives are swapped: the rocking modes couple each drive to the sense of the same"
            f" number ({sure}). The response cannot show which pair is swapped, and theta changes sign"
            f" between the two, so check the cables. If it is the senses, {senses_swapped.advice}; if it is the drives,"
            f" {drives_swapped.advice} instead."
        )
        findings.append(Finding("swap", "fault", text, None, None, found.confidence_sd, None, "sd", senses_swapped))
    elif found.swapped is None:
        text = (
            "The channel order could not be tested: the rocking residues on and off the diagonal differ by less than a"
            f" factor of {DOMINANCE:g}. Check the cables of senses and drives."
        )
        findings.append(Finding("undecided", "note", text))
    return findings


def rest_findings(campaign: Campaign, response: Response) -> list[Finding]:
    """Free motion at the first sample of records that are declared to start at rest."""
    findings = []
    by_name = {record.name: record for record in campaign.records}
    for k, name in enumerate(response.records):
        record = by_name[name]
        if not record.at_rest:
            continue
        # Close modes share the free motion; only their sum is well determined.
        amplitude = np.abs(response.start_v[k].sum(axis=0))
        sd = np.sqrt(np.sum(response.start_sd_v[k] ** 2, axis=0))
        size = record.sense_v.std(axis=0)
        moving = (amplitude > 8.0 * sd) & (amplitude > _REST * size)
        if np.any(moving):
            worst = int(np.argmax(np.where(moving, amplitude / size, 0.0)))
            channel, value, spread = f"sense{worst + 1}", float(amplitude[worst]), float(sd[worst])
            correction = Correction(record={record.file or name: {"at_rest": False}})
            text = (
                f"{channel} oscillates with {value:.3g} +- {spread:.2g} V at the first sample, so the device was already"
                f" moving: {correction.advice}, or wait longer before the record."
            )
            findings.append(Finding("rest", "fault", text, name, channel, value, spread, "V", correction))
    return findings


def short_findings(records: list[Record], response: Response | None) -> list[Finding]:
    """Records shorter than half the decay time of the slowest mode, or too short for a response."""
    findings = []
    for record in records:
        decay = float(np.max(1.0 / np.abs(response.poles.real))) if response else 0.0
        if record.duration_s < 0.5 * decay:
            lasts = record.duration_s
            text = (
                f"The record lasts {lasts:.3g} s, but the slowest mode decays in {decay:.3g} s, so its damping will be"
                f" poorly determined. Record for at least {decay:.3g} s."
            )
            findings.append(Finding("short", "warning", text, record.name, None, lasts, None, "s"))
        elif response is None and record.sense_v.shape[0] < _FEW_SAMPLES:
            text = (
                f"The record has {record.sense_v.shape[0]} samples, too few to fit its response. Record at least"
                f" {_FEW_SAMPLES} samples ({_FEW_SAMPLES / record.sample_rate_hz:.3g} s)."
            )
            findings.append(Finding("short", "warning", text, record.name, None, record.duration_s, None, "s"))
    return findings


def collinear_drives(records: list[Record]) -> list[Finding]:
    """Drives that are proportional to each other in all records together."""
    drive = np.concatenate([record.drive_v - record.drive_v.mean(axis=0) for record in records])
    gram = drive.T @ drive
    scale = np.sqrt(np.diag(gram))
    if not np.all(scale > 0.0):
        return []
    smallest = float(np.linalg.eigvalsh(gram / np.outer(scale, scale))[0])
    if smallest >= 1e-6:
        return []
    text = (
        "The drives carry the same signal in every record (smallest eigenvalue of their correlation matrix"
        f" {abs(smallest):.1g}), so the responses to them cannot be separated. Add records with each drive alone, or with"
        " a different signal on each drive."
    )
    return [Finding("drive", "fault", text)]


def ineffective_drives(response: Response) -> list[Finding]:
    """Drives whose residues vanish."""
    total, sd = response.summed(list(range(response.poles.size)))
    each = np.max(np.abs(response.residues), axis=(0, 1))
    found = []
    for j in range(total.shape[1]):
        lost = bool(np.all(np.abs(total[:, j]) < 4.0 * sd[:, j])) and each[j] < 0.01 * each.max()
        if lost or each[j] < 1e-3 * each.max():
            text = (
                f"drive{j + 1} is commanded but moves nothing: its largest residue is {each[j]:.2g} 1/s, against"
                f" {each.max():.3g} 1/s for the strongest drive. Check its cable, and that [columns] names the right"
                " column of the file."
            )
            found.append(Finding("drive", "fault", text, None, f"drive{j + 1}", float(each[j]), None, "1/s"))
    return found
