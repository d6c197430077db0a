"""One session of the page of a campaign: what the user wants, what was computed, and the panels that show it."""

from __future__ import annotations

from collections.abc import Mapping

from bokeh.document import Document

from pipeline.learning.answers import ComparisonAnswer, DiagnosisAnswer
from reports.words.campaign import class_sentence
from reports.words.explore_loop import NO_NEXT, READY, judged_sentence
from reports.words.terminal import compare_lines

from ..look import Panel, page
from ..parts import paragraphs, printed, text
from ..worker import Session
from .bench import CampaignBench, ChosenModel, Next
from .curves import View
from .effects_panel import EffectsPanel
from .ladder_panel import LadderPanel, statuses
from .next_panel import NEXT, NextPanel
from .residual_panels import ResidualPanels


class CampaignSession:
    """Fills ``document``; the answers of ``bench`` arrive one after the other."""

    def __init__(self, bench: CampaignBench, document: Document, title: str, lead: str) -> None:
        self.bench = bench
        self.terms: tuple[str, ...] = ()
        self.shown: ChosenModel | None = None
        self.views: tuple[View, ...] = ()
        self.effects = EffectsPanel(self.change)
        self.ladder = LadderPanel()
        self.residual = ResidualPanels()
        self.next = NextPanel(self._next, self._list)
        self.where = text()
        self.session = Session(document, self._tell, self._failed)
        where = Panel(self.where, "What compare says of the given model", wide=True)
        page(
            document,
            title,
            lead,
            [
                *self.effects.panels,
                Panel(self.ladder.model, "Ladder", wide=True),
                *self.residual.panels,
                *(self.next.panels if bench.predicts else [Panel(text(paragraphs([NO_NEXT])), NEXT, wide=True)]),
                self.effects.library,
                where,
            ],
        )
        self.session.ask("compare", lambda: (bench.comparison, bench.first), lambda found: self._compared(*found))
        self.change(())

    def change(self, terms: tuple[str, ...]) -> None:
        """Put ``terms`` into the model: the fit first, then what is missing beside it."""
        self.terms = terms
        self.effects.controls.fail("")
        self.effects.chosen(terms)
        self.session.ask("fit", lambda: self.bench.chosen(terms), self._fitted)
        self.session.ask("diagnose", lambda: self.bench.diagnosis(terms), self._diagnosed)

    def _compared(self, answer: ComparisonAnswer, views: tuple[View, ...]) -> None:
        self.views = views
        self.where.text = printed(compare_lines(answer))
        self.residual.show(views, (), _values(answer.parameters))

    def _fitted(self, found: ChosenModel) -> None:
        self.shown = found
        self.ladder.show(found.refinement.ladder, statuses(found, None))
        after = found.views if found.terms else ()
        self.residual.show(self.views, after, _values(found.refinement.ladder[-1].parameters))

    def _diagnosed(self, answer: DiagnosisAnswer) -> None:
        found = self.shown
        more: list[str] = []
        if found is not None and found.terms == self.terms:
            self.ladder.show(found.refinement.ladder, statuses(found, answer))
            more = [judged_sentence(name, test) for name, test in zip(found.terms, found.judged)]
            more += [class_sentence(one) for one in found.refinement.classes]
        self.effects.show(answer, more)
        if self.bench.predicts:
            names = [one.effect for one in answer.candidates if one.detectable]
            self.next.offer([*reversed(self.terms), *names])

    def _list(self, effect: str) -> None:
        without = tuple(name for name in self.terms if name != effect)
        self.session.ask("experiments", lambda: self.bench.experiments(without, effect), self.next.excite)

    def _next(self, effect: str, experiment: Next) -> None:
        without = tuple(name for name in self.terms if name != effect)
        self.session.ask(
            "next",
            lambda: self.bench.next_record(without, effect, experiment),
            lambda found: self.next.show(found, experiment),
        )

    def _tell(self, line: str) -> None:
        self.effects.controls.doing(line or READY)

    def _failed(self, line: str) -> None:
        self.effects.controls.fail(line)
        if self.shown is not None and self.shown.terms != self.terms:
            # The model that is shown is the last one that could be fitted.
            self.terms = self.shown.terms
            self.effects.chosen(self.terms)
            self.session.cancel("diagnose")


def _values(parameters: Mapping[str, tuple[float | None, float | None]]) -> dict[str, float]:
    return {name: value for name, (value, _) in parameters.items() if value is not None}
