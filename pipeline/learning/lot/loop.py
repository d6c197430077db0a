"""The loop for a lot: compare with the population, find what it lacks, add it, look at wafers that no fit has seen.

    prepared      leaking devices are told apart, held-out wafers set aside
    fit           restricted maximum likelihood of all spreads, bows and means
    diagnosed     score tests of all candidates and probes against one simulated null
    refined       the most likely of the best-scoring candidates is added and everything refitted, until none is significant

A name needs a family-wise p below ``ALPHA`` and a refit.  Candidates whose refits are within ``RIVAL`` of the best deviance are
one class.  Where a probe is significant and no candidate is, or stays so beside the best candidate, the misfit is unknown.

Shapes: n devices, q quantities, C random parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import BoolArray
from ...criticism.announce import announce
from ...criticism.budget import ALPHA
from .elimination import log_likelihood
from .model import LotModel, RandomPart
from .null import null_draws
from .outcome import HeldOut, left_out
from .population import DeviceMixture, Part, generic_parts, spread_of
from .prepared import PreparedLot, free, sorted_out
from .reml import LotFit
from .scores import LotScore, scored
from .tails import OUTLIERS, mixture_scores, outliers, tail_scores

#: Lots drawn for a null: the number of independent tests is then known to 5 %.
DRAWS = 400
#: Candidates with the best scores that are refitted.
REFITTED = 6
#: Deviances within this of each other do not tell two candidates apart: a likelihood ratio below 100.
RIVAL = 2.0 * np.log(100.0)
#: Rungs of a ladder, and candidates that may be refused before the search ends.
RUNGS, REFUSED = 8, 20


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
    draws = null_draws(fit, DRAWS, seed)
    found = scored(fit.lot, fit.design, draws, [*own, *probes], ~fit.at_zero)
    out = left_out(fit.lot, fit.model, fit.variances)
    single, tails = mixture_scores(out, [one.subset(seen) for one in mixtures]), tail_scores(fit.lot, out)
    families = sum(bool(family) for family in (found, single, tails))
    named = _together((*found[: len(own)], *single), families)
    shapes = _together((*found[len(own) :], *tails), families)

    def order(score: LotScore) -> tuple[float, float]:
        return (score.log_p, -score.z)

    return LotDiagnosis(fit, tuple(sorted(named, key=order)), tuple(sorted(shapes, key=order)))


def _together(scores: Sequence[LotScore], families: int) -> tuple[LotScore, ...]:
    """Scores whose p-values count all families of tests."""
    return tuple(
        replace(one, p_value=-float(np.expm1(families * np.log1p(-min(one.p_value, 1.0 - 1e-12))))) for one in scores
    )


def _subset(part: Part, chosen: BoolArray) -> Part:
    return replace(part, columns=part.columns[chosen])


@dataclass(frozen=True, eq=False)
class LotRung:
    """One model of the ladder.

    Parameters
    ----------
    part : added on this rung; ``None`` on the first.
    ready : the lot, with the mixtures of this rung.
    fit : its fit.
    model : for all devices.
    outcome : errors and log scores.
    delta_deviance : fall of the deviance against the rung below [-2 ln L].
    status : "confirmed", "partial", or ``None`` on the first rung and where nothing was held out.
    rivals : candidates that this lot cannot tell from ``part``, and their deviances above its own.
    """

    part: str | None
    ready: PreparedLot
    fit: LotFit
    model: LotModel
    outcome: HeldOut
    delta_deviance: float
    status: str | None
    rivals: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class LotLadder:
    """All rungs, the diagnosis of the last one, and the verdict."""

    rungs: tuple[LotRung, ...]
    last: LotDiagnosis
    verdict: str

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the parts that were added."""
        return tuple(rung.part for rung in self.rungs if rung.part is not None)

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Added parts with those that this lot cannot tell from them."""
        return tuple(
            (rung.part, *(name for name, _ in rung.rivals))
            for rung in self.rungs
            if rung.part is not None and rung.rivals
        )


def deviance(rung: LotRung) -> float:
    """-2 ln L plus 2 for each free coefficient, so that fixed and random parts compare."""
    fit, ready = rung.fit, rung.ready
    value = log_likelihood(fit.factor, float(fit.solution.quadratic[0]), False)
    value += float(np.sum(ready.log_share[~ready.whole.is_held]))
    return -2.0 * value + 2.0 * fit.design.fixed


def status_of(gain: float | None) -> str | None:
    """ "confirmed" where the held-out log score rose by more than 2 sd of a log likelihood ratio, whose variance is twice
    its mean (two normal models that are close: Kullback, Information Theory and Statistics (1959), ch. 9)."""
    if gain is None:
        return None
    return "confirmed" if gain > 0.0 and gain > 2.0 * np.sqrt(2.0 * gain) else "partial"


def first_rung(ready: PreparedLot) -> LotRung:
    """The population with its spreads, patterns and means refitted."""
    model = free(ready.population.model)
    fit = ready.fit(model, np.maximum(ready.start, 1e-4))
    return LotRung(None, ready, fit, model, ready.outcome(model, fit.variances), 0.0, None)


def refined(ready: PreparedLot, without: Sequence[str] = (), seed: int = 0) -> LotLadder:
    """The ladder; irregularities of the names ``without`` are no candidates."""
    announce("fitting the population")
    rungs = [first_rung(ready)]
    refused: set[str] = set()
    while True:
        rung = rungs[-1]
        parts = [part for part in candidates_of(rung.ready, rung.model, without) if part.name not in refused]
        mixtures = [one for one in mixtures_of(rung.ready, without) if one.name not in refused]
        announce(f"rung {len(rungs)}: {len(parts) + len(mixtures)} candidates")
        found = diagnosed(rung.ready, rung.fit, parts, mixtures, seed + len(rungs))
        if not found.significant or len(rungs) > RUNGS:
            break
        by_name: dict[str, Part | DeviceMixture] = {one.name: one for one in (*parts, *mixtures)}
        tried = [with_part(rung, by_name[score.name]) for score in found.significant[:REFITTED]]
        tried.sort(key=deviance)
        fall = deviance(rung) - deviance(tried[0])
        if fall < RIVAL:
            refused |= {str(one.part) for one in tried}
            if len(refused) > REFUSED:
                break
            continue
        near = [one for one in tried if deviance(one) - deviance(tried[0]) < RIVAL or one.part == OUTLIERS]
        # A generic part describes what a physical one explains, so that one is added; outliers explain anything.
        near.sort(key=lambda one: (one.part == OUTLIERS, is_generic(str(one.part)), deviance(one)))
        best = near[0]
        fall = deviance(rung) - deviance(best)
        rivals = [
            (str(one.part), deviance(one) - deviance(best))
            for one in near[1:]
            if is_generic(str(one.part)) == is_generic(str(best.part)) and one.part != OUTLIERS
        ]
        gain = _gain(rung.outcome, best.outcome, int(ready.whole.is_held.sum()))
        rungs.append(
            replace(
                best,
                delta_deviance=fall,
                status=status_of(gain),
                rivals=tuple(rivals),
            )
        )
    verdict = _verdict(tuple(rungs), found)
    if verdict == "unknown":
        # What was added on the way to a misfit that remains may have taken its place.
        rungs = [replace(rung, status="partial" if rung.status == "confirmed" else rung.status) for rung in rungs]
    return LotLadder(tuple(rungs), found, verdict)


def _gain(before: HeldOut, after: HeldOut, devices: int) -> float | None:
    """Rise of the log score of all held-out devices."""
    if before.log_score_validate is None or after.log_score_validate is None:
        return None
    return (after.log_score_validate - before.log_score_validate) * devices


def with_part(rung: LotRung, part: Part | DeviceMixture) -> LotRung:
    """The rung with one more part, refitted."""
    # A variance that was at zero may be needed beside the new part.
    start = np.maximum(rung.fit.variances, 1e-4)
    ready, model = rung.ready, rung.model
    if isinstance(part, DeviceMixture):
        mixtures = (*ready.mixtures, part)
        ready = sorted_out(ready.measured, ready.population, mixtures, model, rung.fit.variances)
    else:
        model = model.with_part(part)
        if isinstance(part, RandomPart):
            start = np.append(start, part.start)
    fit = ready.fit(model, start)
    return LotRung(part.name, ready, fit, model, ready.outcome(model, fit.variances), 0.0, None)


def _verdict(rungs: tuple[LotRung, ...], last: LotDiagnosis) -> str:
    if not all(rung.fit.converged for rung in rungs[-1:]):
        return "fit_failed"
    if last.structure or last.significant:
        return "unknown"
    if len(rungs) == 1:
        return "adequate"
    return "class" if any(rung.rivals for rung in rungs) else "adequate"


def fixed_effects(fit: LotFit) -> dict[str, tuple[float, float]]:
    """Coefficient and sd of each fixed part, those of the means aside; only parts of one column."""
    found: dict[str, tuple[float, float]] = {}
    at = 0
    sd = np.sqrt(np.diag(fit.factor.fixed_inverse))
    for part in fit.model.fixed:
        width = part.columns.shape[2]
        if part.name != "mean":
            for k in range(width):
                label = part.name if width == 1 else f"{part.name}[{k}]"
                found[label] = (float(fit.solution.coefficients[at + k, 0]), float(sd[at + k]))
        at += width
    return found
