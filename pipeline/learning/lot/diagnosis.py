"""Score tests of everything that a fitted lot may lack: named candidates and probes, against one simulated null.

Shapes: n devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import BoolArray
from ...criticism.budget import ALPHA
from .family import family_wise
from .model import LotModel
from .null import null_draws
from .outcome import left_out
from .population import DeviceMixture, Part, generic_parts, spread_of
from .prepared import PreparedLot
from .reml import LotFit
from .scores import LotScore, scored, statistic_of
from .tails import OUTLIERS, mixture_scores, outliers, tail_scores

#: Lots drawn for a null: the number of independent tests is then known to 5 %.
DRAWS = 400
#: p of one score, below which a refit may tell more.  The score of a variance far from zero is weak, because the fitted spreads
#: have grown in its place: a wafer_shift of SNR 10 (a fall of the deviance by 100) had p = 1.2e-4 alone, 0.06 family-wise.
PROMISING = 0.01


@dataclass(frozen=True, eq=False)
class LotDiagnosis:
    """Scores of the named candidates and of the probes at one fit, best first."""

    fit: LotFit
    candidates: tuple[LotScore, ...]
    probes: tuple[LotScore, ...]

    @property
    def significant(self) -> tuple[LotScore, ...]:
        """Candidates that may be named."""
        return tuple(score for score in self.candidates if score.p_value < ALPHA)

    @property
    def structure(self) -> tuple[LotScore, ...]:
        """Probes that show structure."""
        return tuple(score for score in self.probes if score.p_value < ALPHA)

    @property
    def promising(self) -> tuple[LotScore, ...]:
        """Candidates whose score alone has a p below ``PROMISING``, or that may be named."""
        return tuple(s for s in self.candidates if s.p_value < ALPHA or (s.visible and s.log_p < np.log(PROMISING)))

    @property
    def tests(self) -> int:
        """Candidates and probes that this lot could show."""
        return sum(score.visible for score in (*self.candidates, *self.probes))

    @property
    def invisible(self) -> tuple[str, ...]:
        """Candidates that this lot cannot show."""
        return tuple(score.name for score in self.candidates if not score.visible)


def candidates_of(ready: PreparedLot, model: LotModel, without: Sequence[str] = ()) -> tuple[Part, ...]:
    """Named candidates that the model lacks: those of the population, then the generic ones, for all devices.

    Irregularities of the names ``without`` are no candidates.
    """
    present = {name for part in model.random for name, _ in part.shares} | {part.name for part in model.fixed}
    generic = generic_parts(ready.whole, spread_of(ready.whole), probes=False)
    every = (*ready.population.candidates, *generic)
    return tuple(part for part in every if part.name not in present and kind_of(part.name) not in without)


def kind_of(part: str) -> str:
    """Name of the irregularity that a part belongs to: "bow" of "bow(f1_hz)", "electrode_gap" of "electrode_gap.wafer"."""
    return part.partition("(")[0].partition(".")[0]


def is_generic(part: str) -> bool:
    """Whether a part belongs to a generic irregularity."""
    return "(" in part or part == OUTLIERS


def mixtures_of(ready: PreparedLot, without: Sequence[str] = ()) -> tuple[DeviceMixture, ...]:
    """Absent mixtures: those of the population's candidates, then outliers of no known kind."""
    present = {mixture.name for mixture in ready.mixtures}
    every = (*ready.population.absent_mixtures, outliers(ready.whole, spread_of(ready.whole)))
    return tuple(one for one in every if one.name not in present and one.name not in without)


def diagnosed(
    ready: PreparedLot,
    fit: LotFit,
    parts: Sequence[Part],
    mixtures: Sequence[DeviceMixture] = (),
    seed: int = 0,
) -> LotDiagnosis:
    """Score every candidate of ``parts`` and ``mixtures`` (for all devices) and every probe at ``fit``."""
    seen = ~ready.whole.is_held
    own = [_subset(part, seen) for part in parts]
    probes = generic_parts(fit.lot, spread_of(fit.lot), probes=True)
    every = [*own, *probes]
    draws = null_draws(fit, DRAWS, seed, [statistic_of(part, fit.lot, fit.design) for part in every])
    found = scored(fit.design, draws, every, ~fit.at_zero)
    out = left_out(fit.lot, fit.model, fit.variances)
    single, tails = (
        mixture_scores(out, [one.subset(seen) for one in mixtures]),
        tail_scores(fit.lot, out, ready.in_mixture[seen]),
    )
    families = sum(bool(family) for family in (found, single, tails))
    named = _together((*found[: len(own)], *single), families)
    shapes = _together((*found[len(own) :], *tails), families)

    def order(score: LotScore) -> tuple[float, float]:
        return (score.log_p, -score.z)

    return LotDiagnosis(fit, tuple(sorted(named, key=order)), tuple(sorted(shapes, key=order)))


def _together(scores: Sequence[LotScore], families: int) -> tuple[LotScore, ...]:
    """Scores whose p-values count all families of tests."""
    return tuple(replace(one, p_value=family_wise(_log(one.p_value), families)) for one in scores)


def _log(p: float) -> float:
    return float(np.log(p)) if p > 0.0 else -np.inf


def _subset(part: Part, chosen: BoolArray) -> Part:
    return replace(part, columns=part.columns[chosen])
