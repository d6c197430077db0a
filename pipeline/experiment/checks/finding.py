"""A finding of ``check``, and the lines of campaign.toml that correct it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ...toml_files import encoded, table
from ..record import Channels

#: "fault": correct the campaign or measure again; "warning": a fit would lose accuracy; "note": for information.
Severity = Literal["fault", "warning", "note"]


@dataclass(frozen=True)
class Correction:
    """Keys of campaign.toml to write or replace.

    Parameters
    ----------
    instrument, channels, device : key -> value in that table.
    record : file -> key -> value in the [[record]] of that file.
    """

    instrument: dict[str, Any] = field(default_factory=dict)
    channels: dict[str, Any] = field(default_factory=dict)
    record: dict[str, dict[str, Any]] = field(default_factory=dict)
    device: dict[str, Any] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.instrument or self.channels or self.record or self.device)

    def joined(self, other: Correction) -> Correction:
        """Both corrections in one; where both write a key, ``other`` wins."""
        names = self.record | other.record
        records = {name: self.record.get(name, {}) | other.record.get(name, {}) for name in names}
        device = self.device | other.device
        return Correction(self.instrument | other.instrument, self.channels | other.channels, records, device)

    @property
    def toml(self) -> str:
        """The lines of campaign.toml."""
        parts = [table("[device]", self.device), table("[instrument]", self.instrument)]
        parts += [table("[channels]", self.channels)]
        parts += [table("[[record]]", {"file": name, **keys}) for name, keys in self.record.items()]
        return "\n".join(part for part in parts if part)

    @property
    def advice(self) -> str:
        """The same as a clause: ``write sense_polarity = [1, -1] under [channels]``; empty without keys."""
        places = [("under [device]", self.device), ("under [instrument]", self.instrument)]
        places += [("under [channels]", self.channels)]
        places += [(f"in the [[record]] of {name}", keys) for name, keys in self.record.items()]
        clauses = [
            f"{' and '.join(f'{name} = {encoded(value)}' for name, value in keys.items())} {where}"
            for where, keys in places
            if keys
        ]
        return f"write {', and '.join(clauses)}" if clauses else ""


@dataclass(frozen=True)
class Finding:
    """One observation about a campaign.

    Parameters
    ----------
    kind : "polarity", "swap", "lag", "hold", "clipping", ...; the table in ``check`` lists all kinds.
    severity : how much it matters.
    text : what was observed, the evidence with units, and what to write into campaign.toml or to check on the bench.
    record, channel : where it was observed; ``None`` means the whole campaign.
    value, sd : the measured quantity and its standard deviation, in ``unit``; ``None`` where there is none.
    correction : keys of campaign.toml that remove the fault; empty where no key can.
    """

    kind: str
    severity: Severity
    text: str
    record: str | None = None
    channel: str | None = None
    value: float | None = None
    sd: float | None = None
    unit: str = ""
    correction: Correction = field(default_factory=Correction)

    @property
    def toml(self) -> str:
        """The lines of campaign.toml that correct it, or an empty string."""
        return self.correction.toml

    def to_dict(self) -> dict[str, Any]:
        """The finding as a JSON object."""
        shown = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "correction"}
        return shown | {"toml": self.toml}


def _composed(
    polarity: tuple[int, ...] | None,
    order: tuple[int, ...] | None,
    more_polarity: tuple[int, ...] | None,
    more_order: tuple[int, ...] | None,
    count: int,
) -> tuple[tuple[int, ...] | None, tuple[int, ...] | None]:
    p, o = polarity or (1,) * count, order or tuple(range(1, count + 1))
    mp, mo = more_polarity or (1,) * count, more_order or tuple(range(1, count + 1))
    # File column f is channel o.index(f) of the records that were checked.
    signs = tuple(p[f] * mp[o.index(f + 1)] for f in range(count))
    places = tuple(o[k - 1] for k in mo)
    return (signs if -1 in signs else None), (places if places != tuple(range(1, count + 1)) else None)


def composed(done: Channels, more: Channels, drives: int, senses: int) -> Channels:
    """The single correction of the files that equals ``done`` followed by ``more``.

    Parameters
    ----------
    done : applied when the files were read (see ``files.channels.correct``).
    more : to be applied to the records that resulted.
    drives, senses : numbers of channels.
    """
    sense_polarity, sense_order = _composed(
        done.sense_polarity, done.sense_order, more.sense_polarity, more.sense_order, senses
    )
    drive_polarity, drive_order = _composed(
        done.drive_polarity, done.drive_order, more.drive_polarity, more.drive_order, drives
    )
    offset = done.drive_offset_v
    if more.drive_offset_v is not None:
        signs, order = done.drive_polarity or (1,) * drives, done.drive_order or tuple(range(1, drives + 1))
        before = done.drive_offset_v or (0.0,) * drives
        offset = tuple(before[f] + signs[f] * more.drive_offset_v[order.index(f + 1)] for f in range(drives))
    return Channels(
        sense_polarity, drive_polarity, sense_order, drive_order, offset, done.lag_samples + more.lag_samples
    )


def channel_correction(done: Channels, more: Channels, drives: int, senses: int) -> Correction:
    """The [channels] keys that change when ``more`` follows ``done``; arguments as in ``composed``.

    A key that returns to its default is written out with the default.
    """
    new = composed(done, more, drives, senses)
    default: dict[str, Any] = {
        "sense_polarity": [1] * senses,
        "drive_polarity": [1] * drives,
        "sense_order": list(range(1, senses + 1)),
        "drive_order": list(range(1, drives + 1)),
        "drive_offset_v": [0.0] * drives,
        "lag_samples": 0,
    }
    changed = {}
    for name, plain in default.items():
        was, now = (plain if getattr(c, name) is None else getattr(c, name) for c in (done, new))
        if np.any(np.not_equal(was, now)):
            changed[name] = list(now) if isinstance(now, tuple) else now
    return Correction(channels=changed)
