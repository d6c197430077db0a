"""What the interactive page of a lot says beside the words of compare, diagnose and refine."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.learning.lot.diagnosis import LotDiagnosis
from pipeline.learning.lot.scores import LotScore

from .numbers import number
from .quantities import p_words

NOT_SIGNIFICANT = "its score alone does not ask for it (p above 0.01)"
LITTLE = "the deviance falls by no more than the best of all candidates would lower it by chance"
STACKED = "all wafers, mean at each place"
NO_PLACES = "The lot has no places of its dies, so there is no wafer map."
NO_FORECAST = "Nothing is forecast: the lot has no limits, or no wafer is held out."


def lot_lead(lot: str, population: str | None) -> str:
    """What the page of a lot starts from."""
    against = "its own spreads (no population file)" if population is None else f"population {population}"
    return f"Lot {lot} against {against}. Nothing is written."


def score_words(one: LotScore) -> str:
    """A candidate in a list: its name and its score."""
    return f"{one.name}: {number(one.z, 3)} sd, p {p_words(one.p_value)}"


def left_sentence(found: LotDiagnosis) -> str:
    """What is missing beside the model with the added irregularities."""
    if found.significant:
        return f"More is missing: {found.significant[0].name} has the best score."
    if found.structure:
        return f"Structure is left that no irregularity of the library explains: {found.structure[0].name}."
    return "No candidate and no structure in the residual is significant."


def refused_sentences(refused: Mapping[str, str]) -> list[str]:
    """Why refine would not add what was added."""
    return [f"Refine would not add {name}: {why}." for name, why in refused.items()]
