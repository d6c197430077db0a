"""Sentences on where the lot of a night comes from, and whether it drifted."""

from __future__ import annotations

from pipeline.learning.lot.gyro import MEANINGS
from pipeline.learning.lot.origin_answers import DepartureAnswer, DriftAnswer, LotOriginAnswers, OriginAnswer

from .lot import LEVELS
from .numbers import number

#: Departures that a terminal shows for each question.
_MOST = 3


def lot_origin_sentence(answer: OriginAnswer) -> str:
    """Whether the lot comes from the population, with the probability and the rate of false alarms."""
    if answer.verdict == "undecided":
        return f"Whether the lot comes from the population {answer.population} is undecided: {answer.reason}."
    if answer.verdict == "departs":
        return (
            f"The lot does not come from the population {answer.population}: only a share p = {number(answer.p_value, 2)}"
            f" of its lots depart as far ({_rate(answer.false_alarm)})."
        )
    return (
        f"The lot agrees with the population {answer.population}: a share p = {number(answer.p_value, 2)} of its lots depart"
        f" as far ({answer.devices} devices; {_rate(answer.false_alarm)})."
    )


def drift_sentence(answer: DriftAnswer) -> str:
    """Whether the lot differs from those of earlier nights."""
    if answer.verdict == "undecided":
        return f"Whether the lot drifted against earlier nights is undecided: {answer.reason}."
    nights = "night" if len(answer.nights) == 1 else "nights"
    against = f"{len(answer.nights)} earlier {nights} ({answer.earlier_devices} devices)"
    if answer.verdict == "drifted":
        return f"The lot drifted against {against}: p = {number(answer.p_value, 2)} ({_rate(answer.false_alarm)})."
    return f"The lot shows no drift against {against}: p = {number(answer.p_value, 2)} ({_rate(answer.false_alarm)})."


def departure_words(one: DepartureAnswer) -> tuple[str, str]:
    """What differs, and by how much."""
    meaning = "" if one.quantity is None else f" ({MEANINGS[one.quantity]})" if one.quantity in MEANINGS else ""
    what = {
        "mean": f"mean of {one.quantity}{meaning}",
        "pattern": f"pattern {one.part}{meaning}",
        "spread": f"spread {one.part}, {LEVELS.get(one.level, 'from place to place')}{meaning}",
    }[one.kind]
    if one.estimate is None:
        return what, "more than the population has"
    share = one.part.endswith("(share)")
    unit = "of the devices" if share else "times the stated one" if one.stated else "spreads of a device"
    shown = f"{number(one.estimate, 3)} {unit}"
    if one.low is not None and one.high is not None:
        shown = f"{number(one.estimate, 3)} ({number(one.low, 3)} to {number(one.high, 3)}) {unit}"
    return what, f"{shown}; stated {number(one.stated, 3)}" if share else shown


def origin_lines(answers: LotOriginAnswers) -> list[str]:
    """Both answers on a terminal, with the numbers that differ most."""
    lines = []
    for sentence, found in (
        (lot_origin_sentence(answers.origin), answers.origin.departures),
        (drift_sentence(answers.drift), answers.drift.departures),
    ):
        lines += [sentence, *(f"  {what}: {size}" for what, size in map(departure_words, found[:_MOST]))]
    return lines


def _rate(false_alarm: float) -> str:
    return f"{number(100.0 * false_alarm, 2)} % of lots that belong would be called different"
