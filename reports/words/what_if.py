"""What-if limits in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .quantities import label, limit_words, percent, percent_range
from .rules import rule_words

if TYPE_CHECKING:
    from ..what_if.content import WhatIf

_BY = {"rule": "the rule alone", "gate": "the gate (bias by an undetected effect)"}


def by_words(by: tuple[str, ...]) -> str:
    """What changed a verdict."""
    return ", ".join(_BY.get(name, label(name)) for name in by)


def headline(content: WhatIf) -> str:
    """The difference of the yields."""
    if not content.changed:
        return "No device changes its verdict."
    change = content.total.new.value - content.total.old.value
    if not change:
        return "The yield stays."
    return f"The yield {'rises' if change > 0 else 'falls'} by {points(abs(change))} points."


def difference_sentence(content: WhatIf) -> str:
    """The interval of the difference, and how many devices change."""
    gained = sum(row.new == "pass" for row in content.changed)
    lost = sum(row.old == "pass" for row in content.changed)
    return (
        f"95 % interval of the difference {points(content.difference.low)} to {points(content.difference.high)} points. {gained}"
        f" devices pass that did not, {lost} no longer pass."
    )


def points(share: float) -> str:
    """A difference of shares in percentage points."""
    return f"{100.0 * share:.1f}".replace("-", "−")


def thinning_sentences(content: WhatIf) -> list[str]:
    """What judging stored draws costs."""
    found = content.thinning
    if found is None:
        return [
            "The rule judges estimates and standard uncertainties, which are stored in full; draws serve the risks alone."
        ]
    if found.stored == 0:
        return [
            "This run stored no posterior draws. Every quantity was drawn from a normal distribution with its estimate and sd,"
            " independent of the others: devices near two limits at once, or with a skew posterior, may be judged otherwise."
        ]
    out = []
    if found.stored < found.of:
        out.append(
            f"Judged from {found.stored} stored draws of a device; the run judged {found.of}. They are weighted so that the old"
            " limits give what the run found. Devices whose verdict is uncertain for that, because P(conform) lies within 2 sd of"
            f" a threshold: {found.doubtful}. Devices that the stored draws alone would judge otherwise than the run by the old"
            f" limits: {found.disagree}."
        )
    if found.normal:
        names = ", ".join(label(name) for name in found.normal)
        out.append(
            f"The draws of {names} do not follow from what is stored. They were taken from a normal distribution with the"
            " estimate and sd of the device, independent of the other quantities."
        )
    return out


def what_if_lines(content: WhatIf) -> list[str]:
    """What ``gyroscreen report --limits`` prints before the path of the page."""
    lines = []
    for name, one in (("old", content.total.old), ("new", content.total.new)):
        interval = percent_range(one.clopper_pearson.low, one.clopper_pearson.high)
        counts = f"{one.passed} pass, {one.failed} fail, {one.undecided} undecided"
        lines.append(f"{name} limits: yield {percent(one.value)} (95 % interval {interval}): {counts}")
    lines.append(f"{headline(content)} {difference_sentence(content)}")
    for row in content.changes:
        parts = [(row.gained, "gained"), (row.lost, "lost"), (row.other, "otherwise changed")]
        lines.append(f"  by {by_words((row.by,))}: " + ", ".join(f"{n} {word}" for n, word in parts if n))
    if content.pairs and content.pairs[0].devices:
        worst = content.pairs[0]
        lines.append(
            f"costliest pair: {label(worst.first.quantity)} {limit_words(worst.first)} ({worst.first_alone} devices alone) and"
            f" {label(worst.second.quantity)} {limit_words(worst.second)} ({worst.second_alone} alone, {worst.both} only with"
            f" both): {percent_range(worst.share.low, worst.share.high)} of all devices"
        )
    return [
        *lines,
        *([] if content.new.rule == content.old.rule else [rule_words(content.new.rule)]),
        *thinning_sentences(content),
    ]
