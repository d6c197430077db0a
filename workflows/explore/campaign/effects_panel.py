"""The effects of the library with their scores, and the controls that add and remove them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.inputs import Select

from pipeline.learning.answers import CandidateAnswer, DiagnosisAnswer
from reports.words.campaign import effect_words, notes, parameter_words
from reports.words.explore_loop import candidate_words
from reports.words.numbers import number, with_sd
from reports.words.quantities import error_words, p_words
from reports.words.terminal import diagnose_lines

from ..look import Panel
from ..parts import controls, error_line, offer, paragraphs, say, stacked, table, text

_HEADS = ("effect", "Δχ²", "p", "error after", "detectable", "size by one step")
_HEIGHT = "24rem"


class EffectsPanel:
    """Controls, verdict and table.

    Parameters
    ----------
    change : called with the effects that the user wants in the model.
    """

    def __init__(self, change: Callable[[tuple[str, ...]], None]) -> None:
        self._change = change
        self._terms: tuple[str, ...] = ()
        self.add = Select(title="Effect to add", width=380)
        self.remove = Select(title="Effect in the model", width=220)
        self.adding = Button(label="Add and refit", button_type="primary", width=130, align="end", disabled=True)
        self.removing = Button(label="Remove", width=90, align="end", disabled=True)
        self.status = text(live=True)
        self.error = text()
        self.error.visible = False
        self.verdict = text(live=True)
        self.table = text()
        self.adding.on_click(self._add)
        self.removing.on_click(self._remove)

    @property
    def panels(self) -> list[Panel]:
        """The panels of the page: controls with the verdict, and the table."""
        both = controls(self.add, self.adding, self.remove, self.removing)
        return [Panel(stacked(both, self.status, self.error, self.verdict), "Effects", wide=True)]

    @property
    def library(self) -> Panel:
        """All absent effects with their scores."""
        note = "Each absent effect tested on the residual of the model above, as diagnose does; p is family-wise."
        return Panel(self.table, "Scores of the absent effects", note, wide=True)

    def chosen(self, terms: tuple[str, ...]) -> None:
        """Show what is in the model now, or will be once the fit is done."""
        self._terms = terms
        offer(self.remove, {name: effect_words(name) for name in terms})
        self.remove.value = terms[-1] if terms else ""
        self.removing.disabled = not terms

    def show(self, found: DiagnosisAnswer, more: Sequence[str]) -> None:
        """Show a diagnosis of the model with the effects that are in it; ``more`` are further sentences."""
        say(self.verdict, paragraphs([diagnose_lines(found)[0], *notes(found), *more]))
        known = [one.effect for one in found.candidates]
        offer(self.add, {one.effect: candidate_words(one) for one in found.candidates})
        self.add.value = next((name for name in found.effects if name in known), known[0] if known else "")
        self.adding.disabled = not known
        marked = [k for k, name in enumerate(known) if name in found.effects]
        self.table.text = table(
            _HEADS, [_row(one) for one in found.candidates], words=(5,), marked=marked, height=_HEIGHT
        )

    def fail(self, line: str) -> None:
        """Show why the last wish failed; "" where it did not."""
        say(self.error, error_line(line))

    def _add(self) -> None:
        if self.add.value and self.add.value not in self._terms:
            self._change((*self._terms, str(self.add.value)))

    def _remove(self) -> None:
        self._change(tuple(name for name in self._terms if name != self.remove.value))


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
