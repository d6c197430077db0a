"""Answers about a lot for notebooks: frozen, they print as the commands do and give tables as pandas frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from pipeline.learning.answers import Answer, to_builtins
from pipeline.learning.lot.answers import LotComparisonAnswer, LotDiagnosisAnswer, LotRefinementAnswer
from pipeline.learning.lot.measured import MeasuredLot
from pipeline.learning.lot.posterior import LotPosteriorAnswer
from populations.spec import PopulationSpec
from reports.words.lot import lot_lines

from ..learning.tables import html
from .loop import LotAnswers

if TYPE_CHECKING:
    import pandas as pd

Command = Literal["compare", "diagnose", "refine"]


@dataclass(frozen=True, eq=False, repr=False)
class LotResult(ABC):
    """An answer about a lot; ``answers`` keeps its fits."""

    answers: LotAnswers

    @property
    def lot(self) -> MeasuredLot:
        """The lot, in the coordinates in which the model is linear."""
        return self.answers.table.lot

    @property
    @abstractmethod
    def answer(self) -> LotComparisonAnswer | LotDiagnosisAnswer | LotRefinementAnswer:
        """The answer as data."""

    @abstractmethod
    def shown(self) -> tuple[pd.DataFrame, ...]:
        """Tables below the text in a notebook."""

    def to_dict(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        return to_builtins(self.answer)

    def page(self) -> str:
        """The page that ``--out`` writes, as HTML."""
        from .page import lot_page  # it loads matplotlib

        return lot_page(self.command, self.answers)

    def posterior(self, count: int = 3) -> LotPosteriorAnswer:
        """Posterior of the ``count`` (1 to 6) most influential spreads, as ``--posterior`` gives it; takes a minute."""
        return self.answers.posterior(self.command, count)

    @property
    @abstractmethod
    def command(self) -> Command:
        """The command that gives the same answer."""

    def __str__(self) -> str:
        return "\n".join(lot_lines(self.answer))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return html(lot_lines(self.answer), self.shown())


@dataclass(frozen=True, eq=False, repr=False)
class LotComparison(LotResult):
    """How well a population explains a lot, and where it fails."""

    @property
    def command(self) -> Command:
        """The command that gives the same answer."""
        return "compare"

    @property
    def answer(self) -> LotComparisonAnswer:
        """The answer as data."""
        return self.answers.comparison

    @property
    def spreads(self) -> pd.DataFrame:
        """One row per random part: level, ratio to the file with its 90 % interval, the parts that it stands for."""
        return _by_name(self.answer.spreads, "part", leave=("sd",))

    @property
    def patterns(self) -> pd.DataFrame:
        """One row per pattern that all wafers share: ratio to the file, and its sd."""
        return _by_name(self.answer.patterns, "pattern")

    @property
    def calibration(self) -> pd.DataFrame:
        """One row per quantity: sd and share inside 90 % of each device against all others."""
        return _by_name(self.answer.calibration, "quantity")

    @property
    def where(self) -> pd.DataFrame:
        """One row per part in which the refitted population fails, the most significant first."""
        return _table(self.answer.where, "part")

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """Where the population fails, and its spreads."""
        return self.where, self.spreads


@dataclass(frozen=True, eq=False, repr=False)
class LotDiagnosisResult(LotResult):
    """What a population lacks."""

    @property
    def command(self) -> Command:
        """The command that gives the same answer."""
        return "diagnose"

    @property
    def answer(self) -> LotDiagnosisAnswer:
        """The answer as data."""
        return self.answers.diagnosis

    @property
    def verdict(self) -> str:
        """ "adequate", "effect", "class", "unknown" or "fit_failed"."""
        return self.answer.verdict

    @property
    def irregularities(self) -> tuple[str, ...]:
        """Named parts: one, or a class."""
        return self.answer.irregularities

    @property
    def candidates(self) -> pd.DataFrame:
        """One row per candidate: score [sd of its null], p alone and family-wise, the most significant first."""
        return _table(self.answer.candidates, "part")

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """The candidates."""
        return (self.candidates,)


@dataclass(frozen=True, eq=False, repr=False)
class LotRefinement(LotResult):
    """The ladder of a population."""

    @property
    def command(self) -> Command:
        """The command that gives the same answer."""
        return "refine"

    @property
    def answer(self) -> LotRefinementAnswer:
        """The answer as data."""
        return self.answers.refinement

    @property
    def verdict(self) -> str:
        """ "adequate", "class", "unknown" or "fit_failed"."""
        return self.answer.verdict

    @property
    def irregularities(self) -> tuple[str, ...]:
        """Parts that were added."""
        return self.answer.irregularities

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Parts that this lot cannot tell apart."""
        return self.answer.classes

    @property
    def table(self) -> pd.DataFrame:
        """One row per rung: errors and log scores on fitted and held-out wafers, forecast and measured yield."""
        rows = []
        for rung in self.answer.ladder:
            row = to_builtins(rung)
            forecast = row.pop("forecast") or {}
            rows.append(row | {f"yield_{name}": forecast.get(name) for name in ("mean", "low", "high", "measured")})
        return _frame(rows).rename_axis("rung")

    @property
    def spreads(self) -> pd.DataFrame:
        """One row per random part of the last rung, as of a comparison."""
        return _by_name(self.answer.spreads, "part", leave=("sd",))

    @property
    def population(self) -> PopulationSpec | None:
        """The refined population, which ``run`` accepts; ``None`` for a lot of other quantities."""
        return self.answers.refined_population

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """The ladder."""
        return (self.table,)


def _frame(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    # pandas takes a quarter of a second to load.
    import pandas as pd

    return pd.DataFrame(list(rows))


def _table(answers: Sequence[Answer], index: str) -> pd.DataFrame:
    found = _frame([to_builtins(one) for one in answers])
    return found.set_index(index) if index in found else found


def _by_name(answers: Mapping[str, Answer], index: str, leave: tuple[str, ...] = ()) -> pd.DataFrame:
    rows = [{index: name, **to_builtins(one)} for name, one in answers.items()]
    found = _frame(rows).drop(columns=list(leave), errors="ignore")
    return found.set_index(index) if index in found else found
