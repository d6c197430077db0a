"""Sentences of the interactive pages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .quantities import UNITS, label, listed, percent, percent_range
from .what_if import difference_sentence, headline

if TYPE_CHECKING:
    from ..what_if.content import WhatIf
    from ..yields import Yield

VERDICT = "verdict"
P_CONFORM = "P(conform)"
ALL_WAFERS = "all wafers"
EXACT = "Judged as by gyroscreen report --limits."
AS_STORED = "By the limits of the run, as in its report."
PREVIEW = "Preview while the limit moves; the judgement follows."
READING_DRAWS = "Reading the draws of this quantity; then its limits can be changed."
NO_DEVICE = "Click a device in a figure, or type its name."
SIMULATING = "Reading the records and fitting the model ..."
NOT_IDENTIFIED = "No device of this run could be identified, so there is no yield; the report names the reasons."
NO_DIES = "The devices of this run have no positions on a wafer."
FIGURES = {
    "limits": "Limits and distribution",
    "wafer": "Wafer map",
    "scatter": "Two quantities",
    "device": "Device",
    "file": "Limits as a file",
    "yield": "Yield",
}
NOTES = {
    "limits": "Drag a line, or type the limits; an empty field is no limit. Drag elsewhere to select devices.",
    "wafer": "Drag to select devices; they are marked in all figures.",
    "scatter": "The same devices; a selection here is marked in the other figures.",
    "device": "",
    "file": "Save this text as new.toml; then gyroscreen report RUN --limits new.toml writes the page of these limits.",
    "yield": "",
}


def quantity_words(quantity: str) -> str:
    """A quantity with its unit, as at an axis."""
    unit = UNITS.get(quantity, "")
    return f"{label(quantity)}, {unit}" if unit else label(quantity)


def night_lead(devices: int, wafers: int, lots: int, rule: str) -> str:
    """How many devices a run has, and the rule by which they are judged."""
    of = [f"{wafers} wafer{'s' if wafers > 1 else ''}"] if wafers else []
    of += [f"{lots} lot{'s' if lots > 1 else ''}"] if lots else []
    where = f" on {' of '.join(of)}" if of else ""
    return f"{devices} device{'s' if devices > 1 else ''}{where}. {rule}"


def counts_sentence(total: Yield) -> str:
    """The devices by verdict."""

    def some(number: int, one: str, more: str) -> str:
        return f"{number} {one if number == 1 else more}"

    first = f"{total.passed} of {total.devices} devices {'passes' if total.passed == 1 else 'pass'}"
    return f"{first}, {some(total.failed, 'fails', 'fail')}, {some(total.undecided, 'is', 'are')} undecided."


def interval_words(total: Yield) -> str:
    """The interval of a yield."""
    interval = total.clopper_pearson
    return f"95 % interval {percent_range(interval.low, interval.high)}"


def against_run(content: WhatIf) -> str:
    """The yield by moved limits beside that by the limits of the run."""
    return f"The limits of the run give {percent(content.total.old.value)}. {headline(content)} {difference_sentence(content)}"


def shown_sentence(shown: int, of: int) -> str:
    """How many devices the map and the scatter plot show; empty if all."""
    return (
        ""
        if shown == of
        else f"{shown} of {of} devices are drawn, evenly chosen; choose a wafer to see all of its devices."
    )


def selected_sentence(number: int, passed: int) -> str:
    """The devices that are selected."""
    if number == 0:
        return "No device is selected."
    if number == 1:
        return f"One device is selected; it {'passes' if passed else 'does not pass'}."
    return f"{number} devices are selected, of which {passed} pass{'es' if passed == 1 else ''}."


def device_sentence(name: str, place: str, verdict: str, failed: Sequence[str], p_pass: float) -> str:
    """The verdict of a device and the limits that it fails."""
    where = f" on {place}" if place else ""
    why = f", by {listed([label(one) for one in failed])}" if failed else ""
    p = "" if math.isnan(p_pass) else f" P(conform) = {p_pass:.3f}."
    return f"{name}{where}: {verdict}{why}.{p}"


def status_sentence(status: str, reason: str) -> str:
    """The status of the identification where it is not ok."""
    return "" if status == "ok" else f"Status {status.replace('_', ' ')}{f': {reason}' if reason else ''}."


def residual_sentence(record: str, error: float, virtual: bool) -> str:
    """Which record is drawn, and how well the model explains the device."""
    source = "simulated again from its seed" if virtual else "read from its campaign"
    return f"Record {record}, {source}, with the nightly model fitted to it: error {error:.3f} (1 is the noise)."


def unknown_device(name: str) -> str:
    """There is no such device."""
    return f"The run has no device {name!r}."
