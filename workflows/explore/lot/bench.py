"""What the page of a lot computes: the answers of compare and diagnose, and the ladder of chosen irregularities.

    refine      the most likely of the best-scoring candidates is added, until none is significant
    chosen      the next one of the list is added, whatever its score

Both refit, judge and forecast by the same functions and seeds, so that a list that holds what refine adds, in its order, has the
same errors, log scores and forecasts.  All fits are kept here, once for the process; only the thread of ``explore.worker`` may
call the methods.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from pipeline.criticism.announce import announce
from pipeline.errors import UsageError
from pipeline.learning.lot.answers import (
    CalibrationAnswer,
    LotComparisonAnswer,
    LotDiagnosisAnswer,
    LotRungAnswer,
    PatternAnswer,
    SpreadAnswer,
)
from pipeline.learning.lot.diagnosis import LotDiagnosis, candidates_of, diagnosed, mixtures_of
from pipeline.learning.lot.loop import LotRung, first_rung, settled, warranted, with_part
from pipeline.learning.lot.outcome import calibrations
from pipeline.learning.lot.population import DeviceMixture, Part
from pipeline.learning.lot.respond import pattern_answers, rung_answer, rung_of_file, spread_answers
from reports.lot.figures import LotMaps
from reports.words.explore_lot import LITTLE, NOT_SIGNIFICANT

from ...lots.loop import LotAnswers
from ...lots.page import maps_of


@dataclass(frozen=True, eq=False)
class ChosenPopulation:
    """The given population with chosen irregularities.

    Parameters
    ----------
    parts : the chosen parts in their order.
    ladder : the population as in its file (if it has one), refitted, and one rung for each part.
    refused : part -> why refine would not add it.
    maps : residuals of the fitted devices beside this model.
    spreads, patterns, calibration : of this model, as in the answers.
    """

    parts: tuple[str, ...]
    ladder: tuple[LotRungAnswer, ...]
    refused: Mapping[str, str]
    maps: LotMaps
    spreads: Mapping[str, SpreadAnswer]
    patterns: Mapping[str, PatternAnswer]
    calibration: Mapping[str, CalibrationAnswer]


class LotBench:
    """One lot and its population; see the module."""

    def __init__(self, answers: LotAnswers) -> None:
        self._lot = answers
        self._rungs: dict[tuple[str, ...], LotRung] = {}
        self._found: dict[tuple[str, ...], LotDiagnosis] = {}
        self._forecasts: dict[tuple[str, ...], LotRungAnswer] = {}

    @property
    def radius_mm(self) -> float:
        """Radius of the wafers [mm]."""
        return self._lot.ready.measured.radius_mm

    @property
    def comparison(self) -> LotComparisonAnswer:
        """The answer of ``gyroscreen compare``."""
        return self._lot.comparison

    @property
    def diagnosis(self) -> LotDiagnosisAnswer:
        """The answer of ``gyroscreen diagnose`` for the given population."""
        return self._lot.diagnosis

    def scores(self, parts: tuple[str, ...]) -> LotDiagnosis:
        """Scores of every candidate beside the population with ``parts``, with the seed of the command."""
        if parts not in self._found:
            rung = self._rung(parts)
            announce("testing the absent irregularities")
            ready, model, seed = rung.ready, rung.model, self._lot.seed + (len(parts) + 1 if parts else 0)
            self._found[parts] = diagnosed(ready, rung.fit, candidates_of(ready, model), mixtures_of(ready), seed)
        return self._found[parts]

    def chosen(self, parts: tuple[str, ...]) -> ChosenPopulation:
        """The population with ``parts``, one rung for each.

        Raises
        ------
        UsageError : a part that is no candidate.
        """
        steps = [parts[:k] for k in range(len(parts) + 1)]
        maps = maps_of(self._rung(parts))
        fit = self._rung(parts).fit
        file = self._as_in_file
        return ChosenPopulation(
            parts,
            (*(() if file is None else (file,)), *(self._forecast(step) for step in steps)),
            {step[-1]: why for step in steps[1:] if (why := self._refused(step))},
            maps,
            spread_answers(fit),
            pattern_answers(fit),
            {
                one.quantity: CalibrationAnswer(one.sd, one.inside_90, one.p_value)
                for one in calibrations(fit.lot, maps.z)
            },
        )

    def _rung(self, parts: tuple[str, ...]) -> LotRung:
        """The model with ``parts``, refitted from the one without the last of them."""
        if parts not in self._rungs:
            announce(f"fitting {' + '.join(('the population', *parts))}")
            self._rungs[parts] = self._added(parts) if parts else first_rung(self._lot.ready)
        return self._rungs[parts]

    def _added(self, parts: tuple[str, ...]) -> LotRung:
        below = self._rung(parts[:-1])
        return settled(below, with_part(below, self._part(parts)))

    def _part(self, parts: tuple[str, ...]) -> Part | DeviceMixture:
        """The last of ``parts``, as the model without it lacks it."""
        below = self._rung(parts[:-1])
        every: tuple[Part | DeviceMixture, ...] = (
            *candidates_of(below.ready, below.model), *mixtures_of(below.ready),
        )  # fmt: skip
        part = next((one for one in every if one.name == parts[-1]), None)
        if part is None:
            raise UsageError(
                "no such irregularity is absent from the model", value=parts[-1], next_step="choose one of the list"
            )
        return part

    def _refused(self, parts: tuple[str, ...]) -> str:
        """Why refine would not add the last of ``parts``; "" where it would."""
        found = self.scores(parts[:-1])
        score = next((one for one in found.promising if one.name == parts[-1]), None)
        if score is None:
            return NOT_SIGNIFICANT
        return "" if warranted(self._rung(parts[:-1]), self._rung(parts), found, self._part(parts)) else LITTLE

    def _forecast(self, parts: tuple[str, ...]) -> LotRungAnswer:
        if parts not in self._forecasts:
            announce("forecasting the yield of the held-out wafers")
            self._forecasts[parts] = rung_answer(self._rung(parts), self._lot.conforms, self._lot.seed)
        return self._forecasts[parts]

    @cached_property
    def _as_in_file(self) -> LotRungAnswer | None:
        return rung_of_file(self._lot.ready, self._lot.conforms, self._lot.seed)
