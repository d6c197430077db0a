"""The irregularities with their scores, the controls that add and remove them, and where the model fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from pipeline.criticism.budget import ALPHA
from pipeline.learning.lot.diagnosis import LotDiagnosis
from pipeline.learning.lot.scores import LotScore
from reports.words.explore_lot import left_sentence, score_words
from reports.words.lot import ADAPTS, LEVELS
from reports.words.numbers import number, with_sd
from reports.words.quantities import p_words, percent

from ..look import Panel
from ..model_controls import ModelControls
from ..parts import paragraphs, say, table, text
from .bench import ChosenPopulation

_SCORES = ("irregularity", "score, sd", "p alone", "p", "share left visible")
_HEIGHT = "22rem"


class IrregularityPanel:
    """Controls, verdict and tables.

    Parameters
    ----------
    change : called with the parts that the user wants in the model.
    """

    def __init__(self, change: Callable[[tuple[str, ...]], None]) -> None:
        self.controls = ModelControls("Irregularity to add", "Added irregularity", 260, change)
        self.scores = text()
        self.quantities = text()
        self.spreads = text()
        self.shapes = text()

    @property
    def panels(self) -> list[Panel]:
        """The controls with the verdict."""
        return [Panel(self.controls.element, "Irregularities", wide=True)]

    @property
    def tables(self) -> list[Panel]:
        """Scores, and where the model fails by quantity, level and pattern."""
        return [
            Panel(
                self.scores,
                "Scores of the absent irregularities",
                "Score tests beside the model above, without refits; p is family-wise.",
                wide=True,
            ),
            Panel(self.quantities, "Where it fails: quantities", "Each device against all others; calibrated: sd 1."),
            Panel(
                self.shapes,
                "Where it fails: patterns without a name",
                "Probes of the residual, the most significant first.",
            ),
            Panel(
                self.spreads, "Where it fails: levels", "Fitted spread over that of the file; 90 % interval.", wide=True
            ),
        ]

    def chosen(self, parts: tuple[str, ...]) -> None:
        """Show what is in the model now, or will be once the fit is done."""
        self.controls.chosen(parts, parts)

    def show(self, found: LotDiagnosis, more: Sequence[str]) -> None:
        """Show the scores beside the model; ``more`` are further sentences."""
        say(self.controls.verdict, paragraphs([*more, left_sentence(found), ADAPTS]))
        first = found.candidates[0].name if found.candidates else ""
        self.controls.offered({one.name: score_words(one) for one in found.candidates}, first)
        marked = [k for k, one in enumerate(found.candidates) if one.p_value < ALPHA]
        self.scores.text = table(_SCORES, [_score(one) for one in found.candidates], marked=marked, height=_HEIGHT)
        probes = [_score(one) for one in found.probes[:8]]
        self.shapes.text = table(
            ("pattern", *_SCORES[1:]),
            probes,
            marked=[k for k, one in enumerate(found.probes[:8]) if one.p_value < ALPHA],
        )

    def places(self, found: ChosenPopulation) -> None:
        """Show where the model fails by quantity and by level."""
        rows = [
            [name, number(one.sd, 3), percent(one.inside_90), p_words(one.p_value)]
            for name, one in found.calibration.items()
        ]
        self.quantities.text = table(("quantity", "sd", "inside the 90 % interval", "p of the shape"), rows)
        spreads = [
            [
                name,
                LEVELS[one.level],
                number(one.ratio, 3),
                f"{number(one.low, 3)} to {number(one.high, 3)}",
                "yes" if one.agrees else "no",
            ]
            for name, one in found.spreads.items()
        ]
        patterns = [[name, LEVELS["all"], with_sd(one.ratio, one.sd), "", ""] for name, one in found.patterns.items()]
        marked = [k for k, one in enumerate(found.spreads.values()) if not one.agrees]
        self.spreads.text = table(
            ("part", "level", "ratio", "90 % interval", "agrees with the file"),
            [*spreads, *patterns],
            words=(1,),
            marked=marked,
            height=_HEIGHT,
        )


def _score(one: LotScore) -> list[str]:
    return [
        one.name,
        number(one.z, 3),
        p_words(math.exp(one.log_p)),
        p_words(one.p_value),
        percent(one.surviving_share),
    ]
