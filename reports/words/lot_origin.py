"""Sentences on where the lot of a night comes from, and whether it drifted."""

from __future__ import annotations

from pipeline.learning.lot.gyro import MEANINGS
from pipeline.learning.lot.origin_answers import DepartureAnswer, DriftAnswer, LotOriginAnswers, OriginAnswer

from .lot import LEVELS
from .numbers import number

#: Departures that a terminal and a page show for each question.
_MOST, ON_PAGE = 3, 6
#: Smallest p-value that is shown by its digits.
CLOSEST = 1e-12
#: Parts that are nothing but the spread of one quantity.
_PLAIN = ("device_spread(", "wafer_shift(", "lot_shift(")


def lot_origin_sentence(answer: OriginAnswer) -> str:
    """Whether the lot comes from the population, with the probability and the rate of false alarms."""
    if answer.verdict == "undecided":
        return f"Whether the lot comes from the population {answer.population} is undecided: {answer.reason}."
    if answer.verdict == "departs":
        return (
            f"The lot does not come from the population {answer.population}: only a share p {_p(answer.p_value)}"
            f" of its lots depart as far ({_rate(answer.false_alarm)})."
        )
    return (
        f"The lot agrees with the population {answer.population}: a share p {_p(answer.p_value)} of its lots depart"
        f" as far ({answer.devices} devices; {_rate(answer.false_alarm)})."
    )


def drift_sentence(answer: DriftAnswer) -> str:
    """Whether the lot differs from those of earlier nights."""
    if answer.verdict == "undecided":
        return f"Whether the lot drifted against earlier nights is undecided: {answer.reason}."
    nights = "night" if len(answer.nights) == 1 else "nights"
    against = f"{len(answer.nights)} earlier {nights} ({answer.earlier_devices} devices)"
    if answer.verdict == "drifted":
        return f"The lot drifted against {against}: p {_p(answer.p_value)} ({_rate(answer.false_alarm)})."
    return f"The lot shows no drift against {against}: p {_p(answer.p_value)} ({_rate(answer.false_alarm)})."


def departure_words(one: DepartureAnswer) -> tuple[str, str]:
    """What differs, and by how much."""
    of = one.part if one.quantity is None else MEANINGS.get(one.quantity, one.quantity)
    level = LEVELS.get(one.level, "from place to place")
    if one.kind == "mean":
        what = f"mean: {of}"
    elif one.kind == "pattern":
        what = f"{one.pattern}: {of}" if one.quantity is not None else f"pattern: {of}"
    elif one.part.startswith(_PLAIN):
        what = f"spread {level}: {of}"
    else:
        what = f"{one.part}, {level}"
    if one.estimate is None:
        return what, "more than the population has"
    share = one.part.endswith("(share)")
    unit = "of the devices" if share else "times the stated one" if one.stated else "sd of a device"
    shown = f"{number(one.estimate, 3)} {unit}"
    if one.low is not None and one.high is not None:
        shown = f"{number(one.estimate, 3)} ({number(one.low, 3)} to {number(one.high, 3)}) {unit}"
    return what, f"{shown}; stated {number(one.stated, 3)}" if share else shown


def p_words(p: float | None) -> str:
    """A p-value; 400 drawn lots say nothing about the digits of a very small one."""
    return "below 1e-12" if p is not None and p < CLOSEST else number(p, 2)


def origin_lines(answers: LotOriginAnswers) -> list[str]:
    """Both answers on a terminal, with the numbers that differ most."""
    lines = []
    for sentence, found in (
        (lot_origin_sentence(answers.origin), answers.origin.departures),
        (drift_sentence(answers.drift), answers.drift.departures),
    ):
        lines += [sentence, *(f"  {what}: {size}" for what, size in map(departure_words, found[:_MOST]))]
    return lines


def _p(p: float | None) -> str:
    shown = p_words(p)
    return shown if shown.startswith("below") else f"= {shown}"


def _rate(false_alarm: float) -> str:
    return f"{number(100.0 * false_alarm, 2)} % of lots that belong would be called different"
