"""One session of the page of a lot: what the user wants, what was computed, and the panels that show it."""

from __future__ import annotations

from bokeh.document import Document

from pipeline.learning.lot.answers import LotComparisonAnswer, LotDiagnosisAnswer
from pipeline.learning.lot.diagnosis import LotDiagnosis
from reports.lot.figures import LotMaps
from reports.words.explore_loop import JUDGING, READY, REFUSED
from reports.words.explore_lot import refused_sentences
from reports.words.lot import compare_lot_lines, diagnose_lot_lines

from ..look import Panel, page
from ..parts import printed, text
from ..worker import Session
from .bench import ChosenPopulation, LotBench
from .ladder_panel import LotLadderPanel
from .map_panels import MapPanels
from .parts_panel import IrregularityPanel


class LotSession:
    """Fills ``document``; the answers of ``bench`` arrive one after the other."""

    def __init__(self, bench: LotBench, document: Document, title: str, lead: str) -> None:
        self.bench = bench
        self.parts: tuple[str, ...] = ()
        self.shown: ChosenPopulation | None = None
        self.first: LotMaps | None = None
        self.irregularities = IrregularityPanel(self.change)
        self.ladder = LotLadderPanel()
        self.maps = MapPanels(bench.radius_mm)
        self.compared = text()
        self.session = Session(document, self._tell, self._failed)
        page(
            document,
            title,
            lead,
            [
                *self.irregularities.panels,
                *self.ladder.panels,
                *self.maps.panels,
                *self.irregularities.tables,
                Panel(self.compared, "What compare says of the given population", wide=True),
            ],
        )
        self.session.ask("compare", lambda: bench.comparison, self._compared)
        self.change(())

    def change(self, parts: tuple[str, ...]) -> None:
        """Put ``parts`` into the model: the refit and the forecast first, then what is missing beside it."""
        self.parts = parts
        self.irregularities.controls.fail("")
        self.irregularities.chosen(parts)
        self.session.ask("fit", lambda: self.bench.chosen(parts), self._fitted)
        self.session.ask(
            "scores",
            lambda: (self.bench.scores(parts), None if parts else self.bench.diagnosis),
            lambda found: self._scored(*found),
        )

    def _compared(self, answer: LotComparisonAnswer) -> None:
        self.compared.text = printed(compare_lot_lines(answer))

    def _fitted(self, found: ChosenPopulation) -> None:
        self.shown = found
        if not found.parts:
            self.first = found.maps
        self._climb(found, None)
        self.irregularities.places(found)
        self.maps.show(self.first or found.maps, found.maps if found.parts and self.first is not None else None)

    def _scored(self, found: LotDiagnosis, answer: LotDiagnosisAnswer | None) -> None:
        if self.shown is not None and self.shown.parts == self.parts:
            self._climb(self.shown, found)
        refused = {} if self.shown is None else self.shown.refused
        lines = refused_sentences(refused) if answer is None else diagnose_lot_lines(answer)[:1]
        self.irregularities.show(found, lines)

    def _climb(self, shown: ChosenPopulation, found: LotDiagnosis | None) -> None:
        """The ladder with the status of each rung."""
        unexplained = found is not None and bool(found.structure) and not found.significant
        words = []
        for rung in shown.ladder:
            name, status = rung.irregularity, rung.status or ""
            if name is None:
                words.append("")
            elif found is None:
                words.append(JUDGING)
            elif name in shown.refused:
                words.append(REFUSED)
            else:
                # As in refine: what was added on the way to a misfit that remains may have taken its place.
                words.append("partial" if unexplained and status == "confirmed" else status)
        self.ladder.show(shown.ladder, words)

    def _tell(self, line: str) -> None:
        self.irregularities.controls.doing(line or READY)

    def _failed(self, line: str) -> None:
        self.irregularities.controls.fail(line)
        if self.shown is not None and self.shown.parts != self.parts:
            # The model that is shown is the last one that could be fitted.
            self.parts = self.shown.parts
            self.irregularities.chosen(self.parts)
            self.session.cancel("scores")
