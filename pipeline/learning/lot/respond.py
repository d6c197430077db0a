"""From fits to the answers of compare, diagnose and refine for a lot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from .answers import (
    CalibrationAnswer,
    ForecastAnswer,
    LotComparisonAnswer,
    LotDiagnosisAnswer,
    LotOutcomeAnswer,
    LotRefinementAnswer,
    LotRungAnswer,
    PartAnswer,
    PatternAnswer,
    SpreadAnswer,
)
from .diagnosis import LotDiagnosis, candidates_of, diagnosed, mixtures_of
from .elimination import factorised, solved
from .forecast import Conforms, YieldForecast, forecast
from .loop import LotLadder, LotRung, first_rung, fixed_effects, refined
from .outcome import HeldOut, calibrations, left_out
from .population import generic_parts, spread_of
from .prepared import PreparedLot
from .reml import LotFit, centred
from .scores import LotScore

#: p of all spreads together, and of all means and patterns, below which they differ from the file.
DIFFERENT = 0.01
#: Entries of a list that the JSON and the pages carry.
LISTED = 12


def predicted(ready: PreparedLot) -> HeldOut | None:
    """Errors and log scores of the population as its file states it; ``None`` for a table without a population file."""
    if ready.population.curvature is None:
        return None
    model = replace(ready.population.model, fixed=())
    return ready.outcome(model, np.ones(len(model.random)))


def comparison(ready: PreparedLot, seed: int = 0) -> LotComparisonAnswer:
    """Compare the lot with its population."""
    rung = first_rung(ready)
    shown = predicted(ready)
    found = diagnosed(ready, rung.fit, generic_parts(ready.whole, spread_of(ready.whole), probes=False), (), seed)
    out = left_out(rung.fit.lot, rung.fit.model, rung.fit.variances)
    spreads, together = spread_answers(rung.fit), spreads_p_value(rung.fit)
    fixed = fixed_p_value(rung.fit)
    where = [score for score in (*found.candidates, *found.probes) if score.p_value < 0.05]
    return LotComparisonAnswer(
        lot=ready.measured.name,
        population=ready.population.name,
        devices=int((~ready.whole.is_held).sum()),
        held_devices=int(ready.whole.is_held.sum()),
        held_wafers=ready.whole.held,
        quantities=ready.whole.quantities,
        error=None if shown is None else _errors(shown),
        log_score=None if shown is None else _log_scores(shown),
        refitted=LotOutcomeAnswer(_errors(rung.outcome), _log_scores(rung.outcome)),
        spreads=spreads,
        spreads_p_value=None if shown is None else together,
        means_p_value=None if shown is None else fixed,
        patterns=pattern_answers(rung.fit),
        calibration={
            one.quantity: CalibrationAnswer(one.sd, one.inside_90, one.p_value)
            for one in calibrations(rung.fit.lot, out.z)
        },
        where=tuple(_part(score) for score in sorted(where, key=lambda one: one.log_p)[:LISTED]),
        mixtures={one.name: one.share for one in ready.mixtures},
        fit_ok=rung.fit.converged,
        as_predicted=None
        if shown is None
        else not found.significant and not found.structure and min(together, fixed) > DIFFERENT,
    )


def spreads_p_value(fit: LotFit) -> float:
    """p of the likelihood ratio between the fitted spreads and those of the file, all together.

    Chi-square with one degree of freedom for each spread, which is cautious where a fitted one is at zero (Self, Liang, JASA 82
    (1987) 605).
    """
    ratio = 2.0 * (fit.log_likelihood - fit.at(np.ones(len(fit.variances))))
    return float(chi2.sf(max(ratio, 0.0), len(fit.variances)))


def fixed_p_value(fit: LotFit) -> float:
    """p of b' Cov(b)^-1 b: means and patterns against those of the file, all together, with the spreads of the file."""
    factor = factorised(fit.design, np.ones(len(fit.variances)))
    b = solved(factor, centred(fit.lot, fit.model)[..., None]).coefficients[:, 0]
    return float(chi2.sf(b @ np.linalg.solve(factor.fixed_inverse, b), len(b)))


def diagnosis(ready: PreparedLot, seed: int = 0) -> LotDiagnosisAnswer:
    """What the population lacks.

    Candidates are scored without refits.  Those whose score is within a likelihood ratio of 100 of the best are one class.
    """
    rung = first_rung(ready)
    found = diagnosed(ready, rung.fit, candidates_of(ready, rung.model), mixtures_of(ready), seed)
    shown = predicted(ready)
    near = _class_of(found)
    verdict = (
        "fit_failed"
        if not rung.fit.converged
        else ("class" if len(near) > 1 else "effect")
        if near
        else ("unknown" if found.structure else "adequate")
    )
    return LotDiagnosisAnswer(
        verdict=verdict,
        irregularities=tuple(score.name for score in near),
        candidates=tuple(_part(score) for score in found.candidates[:LISTED]),
        classes=(tuple(score.name for score in near),) if len(near) > 1 else (),
        invisible=found.invisible,
        unexplained=tuple(_part(score) for score in found.structure[:LISTED]),
        error=None if shown is None else _errors(shown),
        separating=_separating(near),
    )


def _class_of(found: LotDiagnosis) -> tuple[LotScore, ...]:
    significant = found.significant
    if not significant:
        return ()
    best = significant[0].log_p
    return tuple(score for score in significant if score.log_p - best < np.log(100.0))


def _separating(near: tuple[LotScore, ...]) -> dict[str, str]:
    """Which map or quantity would tell the members of a class apart, by what the parts differ in."""
    if len(near) < 2:
        return {}
    advice = {
        "lot": "more lots",
        "wafer": "more wafers of each lot",
        "pattern": "a full wafer map",
        "field": "a full wafer map",
        "wedge": "a full wafer map",
        "bow": "a full wafer map",
        "die": "more devices of each wafer, and a smaller sd of the quantities",
        "package": "the same devices measured before and after packaging",
    }
    return {
        score.name: advice.get(score.name.partition(".")[2], "a smaller sd of the quantity, or more devices")
        for score in near
    }


def refinement(
    ready: PreparedLot, conforms: Conforms | None, seed: int = 0, without: tuple[str, ...] = ()
) -> tuple[LotRefinementAnswer, LotLadder]:
    """The ladder with the yield forecast of each rung; ``conforms`` judges values in the coordinates of the lot."""
    ladder = refined(ready, without, seed)
    rungs = [rung_answer(rung, conforms, seed) for rung in ladder.rungs]
    first = rung_of_file(ready, conforms, seed)
    last = ladder.rungs[-1]
    answer = LotRefinementAnswer(
        ladder=(*(() if first is None else (first,)), *rungs),
        verdict=ladder.verdict,
        irregularities=ladder.added,
        classes=ladder.classes,
        candidates_left=tuple(_part(score) for score in ladder.last.candidates[:LISTED]),
        unexplained=tuple(_part(score) for score in ladder.last.structure[:LISTED]),
        spreads=spread_answers(last.fit),
        patterns=pattern_answers(last.fit),
        mixtures={one.name: one.share for one in last.ready.mixtures},
    )
    return answer, ladder


def rung_of_file(ready: PreparedLot, conforms: Conforms | None, seed: int) -> LotRungAnswer | None:
    shown = predicted(ready)
    if shown is None:
        return None
    model = replace(ready.population.model, fixed=())
    ones = np.ones(len(model.random))
    found = None
    if conforms is not None:
        mixtures = ready.population.mixtures
        found = forecast(ready.whole, model, lambda _: ones, mixtures, conforms, ready.measured.values, seed)
    return LotRungAnswer(
        irregularity=None,
        status=None,
        model="as in the file",
        error_fit=shown.error_fit,
        error_validate=shown.error_validate,
        log_score_fit=shown.log_score_fit,
        log_score_validate=shown.log_score_validate,
        delta_deviance=0.0,
        forecast=_forecast(found),
    )


def rung_answer(rung: LotRung, conforms: Conforms | None, seed: int) -> LotRungAnswer:
    found = None
    if conforms is not None:
        ready = rung.ready
        found = forecast(
            ready.whole,
            rung.model,
            rung.fit.drawn,
            ready.mixtures,
            conforms,
            ready.measured.values,
            seed,
        )
    return LotRungAnswer(
        irregularity=rung.part,
        status=rung.status,
        model="refitted" if rung.part is None else f"with {rung.part}",
        error_fit=rung.outcome.error_fit,
        error_validate=rung.outcome.error_validate,
        log_score_fit=rung.outcome.log_score_fit,
        log_score_validate=rung.outcome.log_score_validate,
        delta_deviance=rung.delta_deviance,
        forecast=_forecast(found),
    )


def _forecast(found: YieldForecast | None) -> ForecastAnswer | None:
    if found is None:
        return None
    return ForecastAnswer(found.mean, found.low, found.high, found.measured, found.inside, found.devices)


def spread_answers(fit: LotFit) -> dict[str, SpreadAnswer]:
    """Fitted spread of each random part over that of the file."""
    return {
        part.name: SpreadAnswer(
            level=part.level,
            ratio=float(np.sqrt(v)),
            low=float(low),
            high=float(high),
            members=tuple(name for name, _ in part.members),
            agrees=bool(low <= 1.0 <= high),
            sd={
                name: float(np.sqrt(v) * size)
                for name, size in zip(fit.lot.quantities, np.sqrt(np.mean(np.sum(part.columns**2, axis=2), axis=0)))
                if size > 0.0
            },
        )
        for part, v, (low, high) in zip(fit.model.random, fit.variances, fit.interval())
    }


def pattern_answers(fit: LotFit) -> dict[str, PatternAnswer]:
    """Fitted patterns; those of the file have a coefficient relative to its own value, so that 1 is as in the file."""
    of_file = {part.name for part in fit.model.fixed if part.size is not None}
    return {
        name: PatternAnswer(value + (1.0 if name in of_file else 0.0), sd)
        for name, (value, sd) in fixed_effects(fit).items()
    }


def _errors(found: HeldOut) -> dict[str, float | None]:
    return {"fit": found.error_fit, "validate": found.error_validate}


def _log_scores(found: HeldOut) -> dict[str, float | None]:
    return {"fit": found.log_score_fit, "validate": found.log_score_validate}


def _part(score: LotScore) -> PartAnswer:
    return PartAnswer(
        irregularity=score.name.partition(".")[0].partition("(")[0],
        part=score.name,
        z=score.z,
        p_single=float(np.exp(score.log_p)),
        p_value=score.p_value,
        surviving_share=score.surviving_share,
    )
