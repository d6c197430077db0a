"""What compare, diagnose and refine print for a lot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import UNSET

from pipeline.learning.lot.answers import (
    CalibrationAnswer,
    ForecastAnswer,
    LotComparisonAnswer,
    LotDiagnosisAnswer,
    LotRefinementAnswer,
    PartAnswer,
    PatternAnswer,
    SpreadAnswer,
)
from pipeline.learning.lot.gyro import MEANINGS

from .numbers import number, with_sd

LotAnswer = LotComparisonAnswer | LotDiagnosisAnswer | LotRefinementAnswer
#: Lines of a list that are printed.
_MOST = 8
LEVELS: Mapping[str, str] = {
    "lot": "from lot to lot",
    "wafer": "from wafer to wafer",
    "device": "from device to device",
    "tester": "from tester to tester",
    "all": "common to all devices",
}
VERDICTS: Mapping[str, str] = {
    "adequate": "No irregularity is missing from the population.",
    "effect": "One irregularity is missing from the population.",
    "class": "An irregularity is missing; this lot cannot tell apart those of its class.",
    "unknown": "Something is missing that no irregularity of the library explains.",
    "fit_failed": "The fit did not converge, so nothing can be said.",
}
EXPLAINED = "With what was added, nothing more is missing."
#: What an error near one means, which readers of a refitted model need to know.
ADAPTS = (
    "A refitted population always has an error near 1 on the wafers of the fit, because its spreads adapt: "
    "compare the log scores and the held-out wafers."
)


def lot_lines(answer: LotAnswer) -> list[str]:
    """The lines of any answer."""
    if isinstance(answer, LotComparisonAnswer):
        return compare_lot_lines(answer)
    return diagnose_lot_lines(answer) if isinstance(answer, LotDiagnosisAnswer) else refine_lot_lines(answer)


def compare_sentence(answer: LotComparisonAnswer) -> str:
    """Whether the lot comes from the population, in one sentence."""
    if not answer.fit_ok:
        return VERDICTS["fit_failed"]
    if answer.as_predicted is None:
        return "The table has no population file; its own spreads are below."
    if answer.as_predicted:
        return "The lot is as the population predicts."
    return "The lot is not as the population predicts."


def compare_lot_lines(answer: LotComparisonAnswer) -> list[str]:
    """Errors, spreads that differ, places of misfit, calibration."""
    held = f", {answer.held_devices} held out on {len(answer.held_wafers)} wafers" if answer.held_devices else ""
    lines = [
        f"lot {answer.lot} against population {answer.population}: {answer.devices} devices in the fit{held}",
        compare_sentence(answer),
    ]
    if answer.error is not None and answer.log_score is not None:
        lines.append(_outcome("as in the file", answer.error, answer.log_score))
    lines.append(_outcome("spreads refitted", answer.refitted.error, answer.refitted.log_score))
    lines += mixture_lines(answer.mixtures)
    if answer.spreads_p_value is not None:
        lines.append(f"all spreads together are those of the file: p {number(answer.spreads_p_value, 2)}")
        lines.append(f"all means and patterns together are those of the file: p {number(answer.means_p_value, 2)}")
    lines += spread_lines(answer.spreads, only_different=answer.error is not None)
    lines += pattern_lines(answer.patterns)
    lines += _places("where it fails after the refit:", answer.where)
    return lines + calibration_lines(answer.calibration)


def _outcome(name: str, error: Mapping[str, float | None], score: Mapping[str, float | None]) -> str:
    return (
        f"{name}: error {number(error['fit'])} on the fitted wafers, {number(error['validate'])} on the held-out"
        f" wafers (1: as predicted); log score {number(score['fit'])}, {number(score['validate'])} a device"
    )


def diagnose_lot_lines(answer: LotDiagnosisAnswer) -> list[str]:
    """Verdict, candidates, what is invisible."""
    lines = [VERDICTS[answer.verdict]]
    if answer.verdict == "adequate":
        lines.append("Whether its spreads, means and patterns hold: gyroscreen compare.")
    if answer.irregularities:
        lines.append(f"missing: {', '.join(answer.irregularities[:_MOST])}")
    lines += [f"  {name} would be told apart by {what}" for name, what in list(answer.separating.items())[:_MOST]]
    lines += _places("candidates:", answer.candidates)
    lines += _places("structure in the residual that has no name:", answer.unexplained)
    if answer.invisible:
        lines.append(f"this lot cannot show: {_some(answer.invisible)}")
    return lines


def refine_lot_lines(answer: LotRefinementAnswer) -> list[str]:
    """The ladder with the yield forecasts, and the verdict."""
    names = [rung.model + (f" ({rung.status})" if rung.status else "") for rung in answer.ladder]
    width = max(map(len, ["model", *names]))
    lines = [
        f"{'model':{width}s} {'error':>7s} {'held out':>9s} {'log score':>10s} {'held out':>9s}  yield of the held-out wafers"
    ]
    for name, rung in zip(names, answer.ladder):
        lines.append(
            f"{name:{width}s} {number(rung.error_fit):>7s} {number(rung.error_validate):>9s} "
            f"{number(rung.log_score_fit):>10s} {number(rung.log_score_validate):>9s}  {forecast_words(rung.forecast)}"
        )
    lines += [ADAPTS, refine_sentence(answer)]
    lines += [f"class: {', '.join(names)}" for names in answer.classes]
    lines += mixture_lines(answer.mixtures)
    lines += _places("structure that nothing explains:", answer.unexplained)
    if answer.population_file is not UNSET:
        lines.append(f"the refined population: {answer.population_file}")
    return lines


def refine_sentence(answer: LotRefinementAnswer) -> str:
    """The verdict on the last rung, in one sentence."""
    return EXPLAINED if answer.verdict == "adequate" and answer.irregularities else VERDICTS[answer.verdict]


def page_headline(
    comparison: LotComparisonAnswer, diagnosis: LotDiagnosisAnswer | None, refinement: LotRefinementAnswer | None
) -> str:
    """What the page says first: whether the lot is as predicted, then what is missing."""
    if refinement is not None and refinement.irregularities:
        return refine_sentence(refinement)
    found = refinement or diagnosis
    if found is None:
        return compare_sentence(comparison)
    numbers = " The size of a spread, a mean or a pattern differs from its file: see Spreads."
    differs = found.verdict == "adequate" and comparison.fit_ok and comparison.as_predicted is False
    return f"{compare_sentence(comparison)} {VERDICTS[found.verdict]}{numbers if differs else ''}"


def forecast_words(found: ForecastAnswer | None) -> str:
    """ "forecast 51.3 % (40.6 to 60.6 %), measured 40.6 % of 160: inside"; a dash where nothing is judged."""
    if found is None:
        return "-"
    return (
        f"forecast {100 * found.mean:.1f} % ({100 * found.low:.1f} to {100 * found.high:.1f} %), measured "
        f"{100 * found.measured:.1f} % of {found.devices}: {'inside' if found.inside else 'outside'}"
    )


def mixture_lines(mixtures: Mapping[str, float]) -> list[str]:
    """Share of each mixture."""
    return [f"{name}: {100 * share:.1f} % of the devices" for name, share in mixtures.items()]


def spread_lines(spreads: Mapping[str, SpreadAnswer], only_different: bool) -> list[str]:
    """Fitted spreads over those of the file; only those whose 90 % interval leaves out 1, or all."""
    chosen = {name: one for name, one in spreads.items() if not (only_different and one.agrees)}
    if not chosen:
        return ["all spreads agree with the file (90 % intervals)"] if spreads else []
    if not only_different:
        return ["spreads (sd, 90 % interval):", *(_absolute(name, one) for name, one in chosen.items())]
    lines = ["spreads that differ from the file (ratio, 90 % interval; one in ten leaves its interval by chance):"]
    for name, one in list(chosen.items())[: 3 * _MOST]:
        stands = f"; stands for {', '.join(one.members)}" if one.members else ""
        lines.append(
            f"  {name}: {number(one.ratio, 3)} ({number(one.low, 3)} to {number(one.high, 3)}), {LEVELS[one.level]}{stands}"
        )
    return lines


def _absolute(name: str, one: SpreadAnswer) -> str:
    """The sd of the quantity that the part moves most, with its interval."""
    sd = max(one.sd.values(), default=0.0)
    unit = sd / one.ratio if one.ratio > 0.0 else 0.0
    ends = f"{number(unit * one.low, 3)} to {number(unit * one.high, 3)}"
    return f"  {name}: {number(sd, 5)} ({ends}), {LEVELS[one.level]}"


def pattern_lines(patterns: Mapping[str, PatternAnswer]) -> list[str]:
    """Fitted patterns over those of the file."""
    if not patterns:
        return []
    return [
        "patterns that all wafers share (1: as in the file):",
        *(f"  {name}: {with_sd(one.ratio, one.sd)}" for name, one in patterns.items()),
    ]


def calibration_lines(calibration: Mapping[str, CalibrationAnswer]) -> list[str]:
    """Left-out residuals by quantity."""
    lines = ["each device against all others, by quantity (sd 1 and 90 % inside: calibrated):"]
    for name, one in calibration.items():
        meaning = f"  {MEANINGS[name]}" if name in MEANINGS else ""
        lines.append(f"  {name:22s} sd {number(one.sd, 3):5s}  {100 * one.inside_90:5.1f} % inside{meaning}")
    return lines


def _places(head: str, parts: Sequence[PartAnswer]) -> list[str]:
    if not parts:
        return []
    return [
        head,
        *(f"  {one.part}: {number(one.z, 3)} sd, p {number(one.p_value, 2)} family-wise" for one in parts[:_MOST]),
    ]


def _some(names: Sequence[str]) -> str:
    more = len(names) - _MOST
    return ", ".join(names[:_MOST]) + (f" and {more} more" if more > 0 else "")
