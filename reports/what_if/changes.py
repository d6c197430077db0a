"""Which devices have another verdict by new limits, and by which limit; the difference of the yields with its interval.

    difference of the yields = (gained - lost) / n
    interval  Agresti and Min: (g - l)/(n + 2) -+ 1.96 sqrt(g + l + 1 - (g - l)^2/(n + 2))/(n + 2)
              and, with G >= 2 wafers as draws, d/n -+ t_{G-1} sqrt(G/(G-1) sum_w (d_w - d n_w/n)^2)/n; the hull of both

g passes are gained and l lost, d = g - l, and d_w is its part in a wafer of n_w devices.  Both verdicts are of the same devices,
so the difference is known better than either yield.

Shapes: B devices.
Source: Agresti and Min 2005, Stat. Med. 24:729.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from pipeline.arrays import BoolArray

from ..coded import CodedText, IntArray, paired
from ..devices import Devices
from ..limits import Limits
from ..yields import LEVEL, Interval
from .judge import Again

#: A smaller change of a probability is rounding.
_OWN_CHANGE = 1e-9


@dataclass(frozen=True)
class ChangedDevice:
    """A device with another verdict.

    Parameters
    ----------
    old, new : verdicts; p_old, p_new : P(conform), nan where unknown.
    by : the quantities whose own probability of conformity changed most in the direction of the verdict; "rule" if none did;
        "gate" if its status changed.
    """

    device_id: str
    lot: str
    wafer: str
    old: str
    new: str
    p_old: float
    p_new: float
    by: tuple[str, ...]


@dataclass(frozen=True)
class LimitChange:
    """Devices whose verdict changed by one quantity ("rule", "gate"): gained passes, lost passes, other changes."""

    by: str
    gained: int
    lost: int
    other: int


def transitions(old: CodedText, new: CodedText) -> tuple[tuple[str, str, int], ...]:
    found, index = paired(old, new)
    number = np.bincount(index, minlength=len(found))
    return tuple((a or "undecided", b or "undecided", int(n)) for (a, b), n in zip(found, number, strict=True))


def difference(old: BoolArray, new: BoolArray, wafers: CodedText) -> Interval:
    n = float(old.size)
    if n == 0:
        return Interval(-1.0, 1.0, "no devices", LEVEL)
    gain = new.astype(np.float64) - old
    net, moved = float(gain.sum()), float(np.abs(gain).sum())
    centre, half = net / (n + 2.0), 1.959964 * np.sqrt(moved + 1.0 - net**2 / (n + 2.0)) / (n + 2.0)
    low, high, method = centre - half, centre + half, "Agresti-Min"
    groups = len(wafers.counts())
    if groups >= 2 and all(wafers.counts()):
        size = np.bincount(wafers.codes).astype(np.float64)
        part = np.bincount(wafers.codes, weights=gain)
        spread = np.sqrt(groups / (groups - 1.0) * float(np.sum((part - net / n * size) ** 2))) / n
        wide = float(stdtrit(groups - 1.0, 0.5 * (1.0 + LEVEL))) * spread
        low, high, method = min(low, net / n - wide), max(high, net / n + wide), "Agresti-Min, and wafers as draws"
    return Interval(max(-1.0, float(low)), min(1.0, float(high)), method, LEVEL)


def changed_devices(devices: Devices, after: Devices, again: Again) -> tuple[ChangedDevice, ...]:
    old, new = devices.text("verdict"), after.text("verdict")
    codes, words = _same_words(old, new)
    rows = np.flatnonzero(codes[0] != codes[1])
    if not rows.size:
        return ()
    names, lots, wafers = (devices.text(name, rows.tolist()) for name in ("device_id", "lot", "wafer"))
    p_old, p_new = devices.number("p_pass")[rows], again.p_pass[rows]
    status = [list(text) for text in (devices.text("status").at(rows), again.status.at(rows))]
    order = {"fail": 0, "undecided": 1, "pass": 2}
    quantities = tuple(dict.fromkeys((*again.own_old, *again.own_new)))
    change = np.array(
        [
            np.nan_to_num(again.own_new[q][rows] if q in again.own_new else np.ones(rows.size))
            - np.nan_to_num(again.own_old[q][rows] if q in again.own_old else np.ones(rows.size))
            for q in quantities
        ]
    )
    out = []
    for k in range(rows.size):
        before, now = words[codes[0][rows[k]]], words[codes[1][rows[k]]]
        towards = change[:, k] * (1.0 if order.get(now, 1) > order.get(before, 1) else -1.0)
        most = float(towards.max())
        by = tuple(quantities[i] for i in np.argsort(-towards, kind="stable") if towards[i] >= 0.5 * most)
        if status[0][k] != status[1][k]:
            by = ("gate",)
        elif most <= _OWN_CHANGE:
            by = ("rule",)
        out.append(ChangedDevice(names[k], lots[k], wafers[k], before, now, float(p_old[k]), float(p_new[k]), by))
    return tuple(out)


def _same_words(a: CodedText, b: CodedText) -> tuple[tuple[IntArray, IntArray], tuple[str, ...]]:
    words = tuple(dict.fromkeys((*a.words, *b.words)))
    codes = tuple(np.array([words.index(w) for w in text.words], dtype=np.int64)[text.codes] for text in (a, b))
    return (codes[0], codes[1]), words


def by_limit(changed: Sequence[ChangedDevice], new: Limits, old: Limits) -> tuple[LimitChange, ...]:
    gained, lost, other = Counter[str](), Counter[str](), Counter[str]()
    for device in changed:
        count = gained if device.new == "pass" else lost if device.old == "pass" else other
        count.update(device.by)
    names = dict.fromkeys((*new.quantities, *old.quantities, "rule", "gate"))
    rows = (LimitChange(name, gained[name], lost[name], other[name]) for name in names)
    return tuple(row for row in rows if row.gained or row.lost or row.other)
