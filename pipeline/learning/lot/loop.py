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

from ...arrays import BoolArray, FloatArray
from ...criticism.announce import announce
from ...criticism.budget import ALPHA
from .elimination import log_likelihood
from .measured import MeasuredLot
from .model import FixedPart, LotModel, RandomPart, means, merged
from .null import null_draws
from .outcome import HeldOut, held_out, members, with_curvature, with_mixture
from .population import DeviceMixture, LotPopulation, Part, distinct, generic_parts, spread_of
from .reml import LotFit, fitted
from .scores import LotScore, scored

#: Lots drawn for a null: the number of independent tests is then known to 5 %.
DRAWS = 400
#: Candidates with the best scores that are refitted.
REFITTED = 6
#: Deviances within this of each other do not tell two candidates apart: a likelihood ratio below 100.
RIVAL = 2.0 * np.log(100.0)
#: Rungs of a ladder.
RUNGS = 8


@dataclass(frozen=True, eq=False)
class PreparedLot:
    """A lot ready for fits.

    Parameters
    ----------
    measured : as read.
    whole : with the linearization's covariance, and without the changes of the mixtures.
    model : of all its devices, with free means and patterns.
    mixtures : with the share that was found.
    leaking : mixture -> (n,) devices that belong to it.
    """

    measured: MeasuredLot
    population: LotPopulation
    whole: MeasuredLot
    model: LotModel
    mixtures: tuple[DeviceMixture, ...]
    leaking: dict[str, BoolArray]

    @property
    def fit_lot(self) -> MeasuredLot:
        """The devices that fits may see."""
        return self.whole.subset(~self.whole.is_held)

    def fit(self, model: LotModel, start: FloatArray | None = None) -> LotFit:
        """Fit to the devices that fits may see."""
        return fitted(self.fit_lot, model.subset(~self.whole.is_held), start)


def free(model: LotModel) -> LotModel:
    """The model with a free mean of each quantity, patterns that are not combinations of others, and merged random parts."""
    n, q = model.offset.shape
    base = means(n, q)
    patterns = [part for part in model.fixed if part.name != base.name]
    return replace(model, fixed=(base, *distinct([base], patterns)), random=merged(model.random))


def prepared(lot: MeasuredLot, population: LotPopulation) -> PreparedLot:
    """Tell the devices of each mixture apart by the population's own spreads, then by the fitted ones."""
    model = free(population.model)
    whole = with_curvature(lot, population.curvature)
    v = np.ones(len(model.random))
    leaking: dict[str, BoolArray] = {}
    mixtures: list[DeviceMixture] = list(population.mixtures)
    clean = whole
    for _ in range(2 if mixtures else 0):
        clean = whole
        for k, mixture in enumerate(mixtures):
            chosen = members(whole, model, v, mixture)
            leaking[mixture.name] = chosen
            # At least half a device, so that a lot without one still may have one.
            mixtures[k] = replace(mixture, share=float((chosen.sum() + 0.5) / (chosen.size + 1.0)))
            clean = with_mixture(clean, mixture, chosen)
        held = clean.is_held
        v = fitted(clean.subset(~held), model.subset(~held)).variances
    return PreparedLot(lot, population, clean, model, tuple(mixtures), leaking)


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


def candidates_of(ready: PreparedLot, model: LotModel, library: Sequence[str] | None = None) -> tuple[Part, ...]:
    """Named candidates that the model lacks: those of the population, then the generic ones, for all devices.

    ``library`` restricts the physical ones to irregularities of these names.
    """
    present = {name for part in model.random for name, _ in part.shares} | {part.name for part in model.fixed}
    physical = [
        part
        for part in ready.population.candidates
        if library is None or part.name.partition(".")[0] in library
    ]
    parts = (*physical, *generic_parts(ready.whole, spread_of(ready.whole), probes=False))
    return tuple(part for part in parts if part.name not in present)


def diagnosed(ready: PreparedLot, fit: LotFit, parts: Sequence[Part], seed: int = 0) -> LotDiagnosis:
    """Score every candidate of ``parts`` (for all devices) and every probe at ``fit``."""
    seen = ~ready.whole.is_held
    own = [_subset(part, seen) for part in parts]
    probes = generic_parts(fit.lot, spread_of(fit.lot), probes=True)
    draws = null_draws(fit, DRAWS, seed)
    found = scored(fit.lot, fit.design, draws, [*own, *probes], ~fit.at_zero)
    named, shapes = found[: len(own)], found[len(own) :]

    def order(score: LotScore) -> tuple[float, float]:
        return (score.log_p, -score.z)

    return LotDiagnosis(fit, tuple(sorted(named, key=order)), tuple(sorted(shapes, key=order)))


def _subset(part: Part, chosen: BoolArray) -> Part:
    return replace(part, columns=part.columns[chosen])


@dataclass(frozen=True, eq=False)
class LotRung:
    """One model of the ladder.

    Parameters
    ----------
    part : added on this rung; ``None`` on the first.
    fit : its fit.
    model : for all devices.
    outcome : errors and log scores.
    delta_deviance : fall of the deviance against the rung below [-2 ln L].
    status : "confirmed", "partial", or ``None`` on the first rung and where nothing was held out.
    rivals : candidates that this lot cannot tell from ``part``, and their deviances above its own.
    """

    part: str | None
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
            (rung.part, *(name for name, _ in rung.rivals)) for rung in self.rungs if rung.part is not None and rung.rivals
        )


def deviance(fit: LotFit) -> float:
    """-2 ln L plus 2 for each free coefficient, so that fixed and random parts compare."""
    return -2.0 * log_likelihood(fit.factor, float(fit.solution.quadratic[0]), False) + 2.0 * fit.design.fixed


def status_of(gain: float | None) -> str | None:
    """ "confirmed" where the held-out log score rose by more than 2 sd of a log likelihood ratio, whose variance is twice
    its mean (two normal models that are close: Kullback, Information Theory and Statistics (1959), ch. 9)."""
    if gain is None:
        return None
    return "confirmed" if gain > 0.0 and gain > 2.0 * np.sqrt(2.0 * gain) else "partial"


def first_rung(ready: PreparedLot) -> LotRung:
    """The population with its spreads, patterns and means refitted."""
    fit = ready.fit(ready.model)
    return LotRung(None, fit, ready.model, held_out(ready.whole, ready.model, fit.variances), 0.0, None)


def refined(ready: PreparedLot, library: Sequence[str] | None = None, seed: int = 0) -> LotLadder:
    """The ladder; ``library`` restricts the physical candidates."""
    announce("fitting the population")
    rungs = [first_rung(ready)]
    refused: set[str] = set()
    while True:
        rung = rungs[-1]
        parts = [part for part in candidates_of(ready, rung.model, library) if part.name not in refused]
        announce(f"rung {len(rungs)}: {len(parts)} candidates")
        found = diagnosed(ready, rung.fit, parts, seed + len(rungs))
        if not found.significant or len(rungs) > RUNGS:
            break
        by_name = {part.name: part for part in parts}
        tried = [
            (score.name, *_refit(ready, rung, by_name[score.name])) for score in found.significant[:REFITTED]
        ]
        tried.sort(key=lambda one: one[3])
        name, model, fit, best = tried[0]
        fall = deviance(rung.fit) - best
        if fall < RIVAL:
            refused |= {one[0] for one in tried}
            if len(refused) > 20:
                break
            continue
        rivals = tuple((other[0], other[3] - best) for other in tried[1:] if other[3] - best < RIVAL)
        outcome = held_out(ready.whole, model, fit.variances)
        before = rung.outcome.log_score_validate
        count = int(ready.whole.is_held.sum())
        gain = None if before is None else (_number(outcome.log_score_validate) - before) * count
        rungs.append(LotRung(name, fit, model, outcome, fall, status_of(gain), rivals))
    return LotLadder(tuple(rungs), found, _verdict(tuple(rungs), found))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _refit(ready: PreparedLot, rung: LotRung, part: Part) -> tuple[LotModel, LotFit, float]:
    model = rung.model.with_part(part)
    start = rung.fit.variances
    if isinstance(part, RandomPart):
        start = np.append(start, part.start)
    # A variance that was at zero may be needed beside the new part.
    fit = ready.fit(model, np.maximum(start, 1e-4))
    return model, fit, deviance(fit)


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


def is_fixed(part: Part) -> bool:
    """Whether a part has coefficients rather than a variance."""
    return isinstance(part, FixedPart)
