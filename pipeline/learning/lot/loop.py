"""The loop for a lot: compare with the population, find what it lacks, add it, look at wafers that no fit has seen.

    prepared      leaking devices are told apart, held-out wafers set aside
    fit           restricted maximum likelihood of all spreads, bows and means
    diagnosed     score tests of all candidates and probes against one simulated null
    refined       the most likely of the best-scoring candidates is added and everything refitted, until none is significant

A name needs a refit, whose likelihood ratio has a family-wise p below ``ALPHA``.  Candidates whose refits are within ``RIVAL`` of
the best deviance are one class.  Where a probe is significant and no candidate is, or stays so beside the best candidate, the
misfit is unknown.

Shapes: n devices, q quantities, C random parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ...criticism.announce import announce
from ...criticism.budget import ALPHA
from .diagnosis import LotDiagnosis, candidates_of, diagnosed, is_generic, kind_of, mixtures_of
from .elimination import log_likelihood
from .family import family_wise
from .model import LotModel, RandomPart
from .outcome import HeldOut
from .population import DeviceMixture, Part
from .prepared import PreparedLot, free, sorted_out
from .reml import LotFit
from .tails import OUTLIERS

#: Candidates with the best scores that are refitted, kinds of which the best one is, and others of the kind that is added.
REFITTED, OF_KINDS, OF_ONE_KIND = 6, 8, 4
#: Deviances within this of each other do not tell two candidates apart: a likelihood ratio below 100.
RIVAL = 2.0 * np.log(100.0)
#: Rungs of a ladder, and candidates that may be refused before the search ends.
RUNGS, REFUSED = 8, 20


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
        if not found.promising or len(rungs) > RUNGS:
            break
        by_name: dict[str, Part | DeviceMixture] = {one.name: one for one in (*parts, *mixtures)}
        every = _refitted(rung, found, by_name)
        tried = [one for one in every if warranted(rung, one, found, by_name[str(one.part)])]
        if not tried:
            refused |= {str(one.part) for one in every}
            if not found.significant or len(refused) > REFUSED:
                break
            continue
        near = [one for one in tried if deviance(one) - deviance(tried[0]) < RIVAL or one.part == OUTLIERS]
        # A generic part describes what a physical one explains, so that one is added; outliers explain anything.
        near.sort(key=lambda one: (one.part == OUTLIERS, is_generic(str(one.part)), deviance(one)))
        best = near[0]
        rivals = [
            (str(one.part), deviance(one) - deviance(best))
            for one in near[1:]
            if is_generic(str(one.part)) == is_generic(str(best.part)) and one.part != OUTLIERS
        ]
        rungs.append(replace(settled(rung, best), rivals=tuple(rivals)))
    verdict = _verdict(tuple(rungs), found)
    if verdict == "unknown":
        # What was added on the way to a misfit that remains may have taken its place.
        rungs = [replace(rung, status="partial" if rung.status == "confirmed" else rung.status) for rung in rungs]
    return LotLadder(tuple(rungs), found, verdict)


def settled(below: LotRung, rung: LotRung) -> LotRung:
    """The rung with the devices of its mixtures told apart by its own spreads, and what it gains on the one below.

    Spreads that had grown in place of the new part hid small leaks, which are heavy tails once the spreads are right.
    """
    ready = rung.ready
    if ready.mixtures:
        ready = sorted_out(ready.measured, ready.population, ready.mixtures, rung.model, rung.fit.variances)
        fit = ready.fit(rung.model, np.maximum(ready.start, 1e-4))
        rung = replace(rung, ready=ready, fit=fit, outcome=ready.outcome(rung.model, fit.variances))
    gain = _gain(below.outcome, rung.outcome, int(ready.whole.is_held.sum()))
    return replace(rung, delta_deviance=deviance(below) - deviance(rung), status=status_of(gain))


def _refitted(rung: LotRung, found: LotDiagnosis, by_name: Mapping[str, Part | DeviceMixture]) -> list[LotRung]:
    """The rung with each of the best candidates, the most likely first.

    Of each kind at least the best is refitted: 132 correlations would otherwise hide a physical cause whose variance they share.
    """
    first = {score.name for score in found.promising[:REFITTED]}
    kinds: set[str] = set()
    for score in found.promising:
        if kind_of(score.name) not in kinds and len(kinds) < OF_KINDS:
            kinds.add(kind_of(score.name))
            first.add(score.name)
    tried = sorted((with_part(rung, by_name[name]) for name in sorted(first)), key=deviance)
    alike = [s.name for s in found.promising if s.name not in first and kind_of(s.name) == kind_of(str(tried[0].part))]
    return sorted((*tried, *(with_part(rung, by_name[name]) for name in alike[:OF_ONE_KIND])), key=deviance)


def warranted(rung: LotRung, one: LotRung, found: LotDiagnosis, part: Part | DeviceMixture) -> bool:
    """Whether the deviance falls by more than the best of all tests would make it fall by chance.

    Half of chi-square with one degree of freedom for a variance, which may be zero (Self, Liang, JASA 82 (1987) 605).  A mixture
    has no such law, so that its score decides.
    """
    fall = deviance(rung) - deviance(one)
    if fall < RIVAL:
        return False
    if isinstance(part, DeviceMixture):
        return one.part in {score.name for score in found.significant}
    columns = part.columns.shape[2]
    random = isinstance(part, RandomPart)
    alone = np.log(0.5) + chi2.logsf(fall, 1) if random else chi2.logsf(fall + 2.0 * columns, columns)
    return family_wise(float(alone), found.tests) < ALPHA


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
