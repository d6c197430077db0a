"""Texts of the page of a night as HTML; everything that comes from files is escaped."""

from __future__ import annotations

from html import escape

import numpy as np

from reports.html.rendering import number
from reports.limits import Limit
from reports.words import explore as words
from reports.words.quantities import UNITS, label, limit_words, percent
from reports.words.rules import rule_words

from .judged import JudgedLimits
from .preview import VERDICTS
from .stored import NightData

_SMALL = 'style="color: var(--muted); font-size: 0.87rem"'


def yield_html(night: NightData, found: JudgedLimits, message: str) -> str:
    """The yield, its interval and the devices by verdict; ``message``: why a limit was refused."""
    total = found.total
    if not night.devices.identified():
        return f'<div class="total"><strong class="refused">{escape(words.NOT_IDENTIFIED)}</strong></div>'
    state = words.PREVIEW if not found.exact else words.EXACT if found.against_run else words.AS_STORED
    more = [found.against_run] if found.against_run else []
    parts = [
        f'<span class="yield" style="font-size: 2.4rem; font-weight: 700; font-variant-numeric: tabular-nums">'
        f"{escape(percent(total.value))}</span> <span>{escape(words.interval_words(total))}</span>",
        escape(words.counts_sentence(total)),
        *[escape(line) for line in more],
        f'<span class="state" {_SMALL}>{escape(state)}</span>',
    ]
    if message:
        parts.append(f'<strong class="refused">{escape(message)}</strong>')
    lines = "".join(f'<div style="margin: 2px 0">{part}</div>' for part in parts)
    return f'<div class="total">{lines}</div>'


def device_html(night: NightData, found: JudgedLimits, number_: int) -> str:
    """Verdict, reasons and estimates of a device."""
    devices = night.devices
    name = night.device_ids[number_]
    failed = found.failed[number_].split(",") if found.failed is not None and found.failed[number_] else []
    text = words.device_sentence(
        name, night.wafers[number_], VERDICTS[int(found.codes[number_])], failed, float(found.p_pass[number_])
    )
    status = words.status_sentence(night.status(found.limits)[number_], devices.text("status_reason", [number_])[0])
    limits = {one.quantity: one for one in found.limits.limits}
    quantities = dict.fromkeys((*limits, "theta_deg", "split_hz"))
    rows = "".join(_row(night, quantity, limits.get(quantity), number_) for quantity in quantities)
    head = "".join(
        f'<th style="text-align: right; padding: 0 10px 0 0">{one}</th>'
        for one in ("", "estimate", "sd", "limit", "truth")
    )
    table = (
        '<div style="overflow-x: auto"><table style="border-collapse: collapse; font-variant-numeric: tabular-nums">'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )
    return f'<p class="verdict" style="margin: 0 0 4px"><strong>{escape(text)}</strong> {escape(status)}</p>{table}'


def _row(night: NightData, quantity: str, limit: Limit | None, row: int) -> str:
    value, sd, true = (float(night.value(name)[row]) for name in (quantity, f"{quantity}_sd", f"true_{quantity}"))
    digits = (
        3 if not np.isfinite(sd) or sd <= 0.0 else int(np.clip(np.ceil(np.log10(max(abs(value) / sd, 1.0))) + 2, 3, 9))
    )
    unit = UNITS.get(quantity, "")
    out = limit is not None and np.isfinite(value) and not bool(limit.admits(np.array(value)))
    cells = [
        f"{label(quantity)}{f' [{unit}]' if unit else ''}",
        number(value, digits),
        number(sd, 2),
        "" if limit is None else limit_words(limit),
        number(true, digits),
    ]
    weight = "font-weight: 700" if out else ""
    return f'<tr style="{weight}">{"".join(_cell(cell, first=k == 0) for k, cell in enumerate(cells))}</tr>'


def _cell(text: str, first: bool) -> str:
    side = "left" if first else "right"
    return f'<td style="text-align: {side}; padding: 1px 10px 1px 0; white-space: nowrap">{escape(text)}</td>'


def note_html(text: str, name: str = "note") -> str:
    """A remark; ``name`` is its class."""
    return f'<span class="{name}" {_SMALL}>{escape(text)}</span>'


def lead(night: NightData) -> str:
    """How many devices, and the rule."""
    lots = sum(1 for name in night.devices.text("lot").counts() if name)
    return words.night_lead(len(night.devices), len(night.wafer_names), lots, rule_words(night.limits.rule))
