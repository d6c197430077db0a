"""Free decays: frequency and damping at the largest and at the smallest motion, measured without a model.

Shapes: sense samples (N, S).
"""

from __future__ import annotations

from ..decays.backbone import Oscillation, backbone
from ..record import Campaign, Record
from .finding import Finding

#: Relative sd of a damping ratio that is worth stating.
_CLEAR = 0.2


def is_decay(record: Record) -> bool:
    """Whether a record has no drive at all: a piece of a free decay, or silence behind one."""
    return record.drive_v.shape[1] == 0


def decays(campaign: Campaign) -> list[Finding]:
    """What the pieces of a decay show: frequency and damping against amplitude, and whether they change."""
    pieces = [record for record in campaign.records if is_decay(record) and record.role != "noise"]
    found = [(record, one) for record in pieces for one in backbone(record.sense_v, record.sample_rate_hz)]
    seen = [(record, one) for record, one in found if one.found and one.zeta_sd < _CLEAR * one.zeta]
    if not seen:
        return []
    (large, a), (small, b) = (pick(seen, key=lambda item: item[1].amplitude) for pick in (max, min))
    unit = large.units.get("sense1_V", "V")
    text = (
        f"Free decay in {len(pieces)} pieces: {_at(a, unit)} in {large.name}"
        + (f"; {_at(b, unit)} in {small.name}" if small is not large else "")
        + ". Nothing states the force, so modes, initial states and sizes of effects are in units of the sense signal."
    )
    return [Finding("decay", "note", text, large.name, None, a.f_hz, a.f_sd_hz, "Hz")]


def _at(one: Oscillation, unit: str) -> str:
    return (
        f"{one.f_hz:.6g} +- {one.f_sd_hz:.2g} Hz, damping ratio {one.zeta:.3g} +- {one.zeta_sd:.1g} at an amplitude of"
        f" {one.amplitude:.3g} {unit}"
    )
