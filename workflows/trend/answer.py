"""Night against night: the comparison with one run, or with the last ones, and the alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.errors import UsageError
from reports.limits_origin import recorded_origin
from reports.trend.charted import YIELD, night_limits
from reports.trend.content import (
    FALSE_ALARM,
    InputChange,
    LeftOutNight,
    TrendContent,
    chart_alarms,
    charts_of,
    limit_alarms,
)
from reports.trend.difference import Comparison, compared
from reports.trend.night import Night, NightSummary

from .alarms import given
from .changed import changes
from .nights import Selection, StoredNight, charted, chosen, inputs_of, read_night, same_draws, select, stored_night

_LAST = "last:"
_MOST = 1000


def trend(
    results: Path, run_id: str | None, against: str, alarms: Sequence[str] = (), without: Sequence[str] = ()
) -> TrendContent:
    """The run ``run_id`` (``None``: the newest) against another one, or against the last N before it ("last:N").

    Parameters
    ----------
    against : the name of a run, or "last:N".
    alarms : as of --alarm; see :func:`workflows.trend.alarms.given`.
    without : earlier runs that are left out.

    Raises
    ------
    UsageError : no such run, or nothing to compare with.
    ConfigError : an alarm cannot be used.
    IntegrityError : a run is not what was committed.
    """
    tonight, runs = chosen(results, run_id)
    table = given(tonight.config.trend, alarms)
    limits = night_limits(table.limits, "[trend]")
    names = tuple(dict.fromkeys((*charted(tonight.limits), *(one.quantity for one in limits if one.quantity != YIELD))))
    false_alarm = table.false_alarm or FALSE_ALARM
    if against.startswith(_LAST):
        selection = select(results, tonight, runs, _number(against), without)
        nights, selection = _read(results, selection, names)
        same = [one.limits == tonight.limits for one in (*selection.earlier, tonight)]
        charts = charts_of(nights, names, false_alarm, same)
        earlier = selection.earlier[-1] if selection.earlier else None
    else:
        earlier = _named(results, against, tonight)
        selection = Selection(tonight, (earlier,), ())
        nights, charts = [_identified(read_night(results, tonight, names)).summary(names)], ()
    comparison, changed = (None, ()) if earlier is None else _compared(results, earlier, tonight, names)
    return TrendContent(
        run_id=tonight.run_id,
        created=tonight.manifest.created,
        devices=tonight.devices,
        comparison=comparison,
        changes=changed,
        charts=charts,
        nights=tuple(night.run_id for night in (*selection.earlier, tonight)),
        left_out=selection.left_out,
        false_alarm=false_alarm,
        alarms=chart_alarms(charts, tonight.run_id),
        broken_limits=limit_alarms(nights[-1], limits),
        gated=table.false_alarm is not None,
        limits=recorded_origin(tonight.manifest.provenance, tonight.stated),
    )


def _number(against: str) -> int:
    text = against.removeprefix(_LAST)
    if not (text.isascii() and text.isdecimal() and len(text) < 5 and 1 <= int(text) <= _MOST):
        raise UsageError(
            "--against names no number of nights",
            value=against,
            allowed=f"last:1 to last:{_MOST}, or the id of a run",
            next_step="for example --against last:10",
        )
    return int(text)


def _named(results: Path, against: str, tonight: StoredNight) -> StoredNight:
    found, _ = chosen(results, against)
    if found.run_id == tonight.run_id:
        raise UsageError(
            "--against names the run itself", value=against, allowed="another run", next_step="name an earlier run"
        )
    return stored_night(results, found.manifest)


def _read(results: Path, selection: Selection, names: Sequence[str]) -> tuple[list[NightSummary], Selection]:
    """All nights, tonight last; one without any identified device, or with tonight's devices again, is left out."""
    measured = selection.tonight.config.source.kind == "campaigns"
    tonight = _identified(read_night(results, selection.tonight, names, identities=measured))
    kept: list[tuple[StoredNight, NightSummary]] = []
    left: list[LeftOutNight] = []
    seen = {frozenset(tonight.device_id)}
    for stored in reversed(selection.earlier):
        night = read_night(results, stored, names, identities=measured)
        devices = frozenset(night.device_id)
        if not night.identified:
            left.append(LeftOutNight(night.run_id, "no device could be identified"))
        elif measured and devices in seen:
            left.append(LeftOutNight(night.run_id, "the same devices as a later night"))
        else:
            kept.append((stored, night.summary(names)))
            seen.add(devices)
    nights = [night for _, night in reversed(kept)]
    earlier = tuple(stored for stored, _ in reversed(kept))
    gone = {one.run_id for one in left}
    others = tuple(one for one in selection.left_out if one.run_id not in gone)
    return [*nights, tonight.summary(names)], replace(selection, earlier=earlier, left_out=(*others, *left))


def _identified(night: Night) -> Night:
    """``night``, if it has a yield."""
    if not night.identified:
        raise UsageError(
            "no device of the run could be identified, so it has no yield and no means to compare",
            value=night.run_id,
            allowed="a run with at least one identified device",
            next_step="name another run; gyroscreen report shows the reasons",
        )
    return night


def _compared(
    results: Path, earlier: StoredNight, tonight: StoredNight, names: Sequence[str]
) -> tuple[Comparison, tuple[InputChange, ...]]:
    """The differences from one run to another, device by device where both hold the same devices."""
    before, after = (_identified(read_night(results, one, names, identities=True)) for one in (earlier, tonight))
    measured = tonight.config.source.kind == earlier.config.source.kind == "campaigns"
    paired = (measured or same_draws(earlier.config, tonight.config)) and set(before.device_id) == set(after.device_id)
    inputs = (inputs_of(results, earlier), inputs_of(results, tonight))
    changed = changes((earlier.manifest, earlier.config, inputs[0]), (tonight.manifest, tonight.config, inputs[1]))
    return compared(before, after, names, paired), changed
