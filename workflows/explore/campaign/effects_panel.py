"""The effects of the library with their scores, and the controls that add and remove them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pipeline.learning.answers import CandidateAnswer, DiagnosisAnswer
from reports.words.campaign import effect_words, notes, parameter_words
from reports.words.explore_loop import candidate_words
from reports.words.numbers import number, with_sd
from reports.words.quantities import error_words, p_words
from reports.words.terminal import diagnose_lines

from ..look import Panel
from ..model_controls import ModelControls
from ..parts import paragraphs, say, table, text

_HEADS = ("effect", "Δχ²", "p", "error after", "detectable", "size by one step")
_HEIGHT = "24rem"


class EffectsPanel:
    """Controls, verdict and table.

    Parameters
    ----------
    change : called with the effects that the user wants in the model.
    """

    def __init__(self, change: Callable[[tuple[str, ...]], None]) -> None:
        self.controls = ModelControls("Effect to add", "Effect in the model", 220, change)
        self.table = text()

    @property
    def panels(self) -> list[Panel]:
        """The panels of the page: controls with the verdict, and the table."""
        return [Panel(self.controls.element, "Effects", wide=True)]

    @property
    def library(self) -> Panel:
        """All absent effects with their scores."""
        note = "Each absent effect tested on the residual of the model above, as diagnose does; p is family-wise."
        return Panel(self.table, "Scores of the absent effects", note, wide=True)

    def chosen(self, terms: tuple[str, ...]) -> None:
        """Show what is in the model now, or will be once the fit is done."""
        self.controls.chosen(terms, {name: effect_words(name) for name in terms})

    def show(self, found: DiagnosisAnswer, more: Sequence[str]) -> None:
        """Show a diagnosis of the model with the effects that are in it; ``more`` are further sentences."""
        say(self.controls.verdict, paragraphs([diagnose_lines(found)[0], *notes(found), *more]))
        known = [one.effect for one in found.candidates]
        first = next((name for name in found.effects if name in known), known[0] if known else "")
        self.controls.offered({one.effect: candidate_words(one) for one in found.candidates}, first)
        marked = [k for k, name in enumerate(known) if name in found.effects]
        self.table.text = table(
            _HEADS, [_row(one) for one in found.candidates], words=(5,), marked=marked, height=_HEIGHT
        )


def _row(one: CandidateAnswer) -> list[str]:
    sizes = (f"{parameter_words(name).rpartition(': ')[2]} = {with_sd(*value)}" for name, value in one.estimate.items())
    return [
        effect_words(one.effect),
        number(one.delta_chi2, 4),
        p_words(one.p_value),
        error_words(one.error_after),
        "yes" if one.detectable else "no",
        ", ".join(sizes),
    ]
