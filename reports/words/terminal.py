"""What compare, diagnose and refine print on a terminal and in a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import UNSET

from pipeline.learning.answers import (
    CandidateAnswer,
    ComparisonAnswer,
    DiagnosisAnswer,
    Place,
    RefinementAnswer,
    RungAnswer,
    Values,
)

from .campaign import (
    UNCONVERGED,
    failure_sentence,
    missing_sentence,
    noise_sentence,
    notes,
    reason_words,
)
from .numbers import number, volts, with_sd
from .quantities import place_words
from .records import record_sentences
from .support import NO_LIMITS, support_words

#: Lines of a list that are printed.
_MOST = 8
#: Length of the longest bar, and the misfit at which a bar has no length.
_BAR, _NO_BAR = 30, 1e-2


def lines_of(answer: ComparisonAnswer | DiagnosisAnswer | RefinementAnswer) -> list[str]:
    """The lines of any answer."""
    if isinstance(answer, ComparisonAnswer):
        return compare_lines(answer)
    return diagnose_lines(answer) if isinstance(answer, DiagnosisAnswer) else refine_lines(answer)


def compare_lines(answer: ComparisonAnswer) -> list[str]:
    """Errors, noise level, and the places with most of the misfit."""
    if not answer.error and not answer.fit_ok:
        return [failure_sentence(answer.why or "")]
    error, relative = answer.error, answer.relative_error
    if answer.dof is not UNSET:
        lines = [
            f"relative error {_percent(relative['fit'])} of the residues at resonance, error {number(error['fit'])}"
        ]
    else:
        lines = [
            f"error {number(error['fit'])} on the fitted records, {number(error['validate'])} on the held-out records"
            " (1 is the noise level)",
            f"relative error {_percent(relative['fit'])} on the fitted records, {_percent(relative['validate'])} on the"
            " held-out records",
        ]
        lines += [f"{answer.status}: {answer.status_reason}"] if answer.status_reason else []
    lines += _device(answer)
    lines.append(noise_sentence(answer.noise or None))
    lines += record_sentences(answer)
    if not answer.fit_ok:
        lines.append(UNCONVERGED)
    if not answer.where:
        return [*lines, "no region has more residual than the noise explains"]
    lines += [_place(place) for place in (answer.where_by_kind or ())[:_MOST]]
    places = [place for place in answer.where if place.family in ("frequency", UNSET)]
    if answer.where_by_kind and places:
        lines.append("most of it in")
    lines += [_place(place) for place in sorted(places, key=lambda place: -place.share)[:_MOST]]
    if answer.four_thetas_deg:
        thetas = ", ".join(with_sd(value, sd) for value, sd in answer.four_thetas_deg.values())
        lines.append(f"four thetas (u1, v1, u2, v2) {thetas} deg, spread {answer.theta_spread_deg:.2f} deg")
    return lines


def diagnose_lines(answer: DiagnosisAnswer) -> list[str]:
    """The verdict, the most significant candidates, and notes."""
    lines = [_verdict(answer, answer.error.get("fit") is not None)]
    if answer.relative_error:
        lines.append(f"relative error {_percent(answer.relative_error['fit'])}, {answer.dof} degrees of freedom")
    lines += [f"  {one.effect:24s} {_test(one)}; {_sizes(one.estimate)}" for one in answer.candidates[:_MOST]]
    for pair in answer.pairs or ():
        share = _percent(pair.share_of_chi2)
        lines.append(f"  {' + '.join(pair.effects):44s} takes {share} of chi2, p {_p(pair.p_value)} among all pairs")
    lines += [*notes(answer), *_device(answer)]
    if answer.declared:
        lines.append(f"not tested, because the record declares the condition: {', '.join(answer.declared)}")
    if answer.invisible:
        lines.append(f"these data cannot show: {', '.join(answer.invisible)}")
    return lines


def refine_lines(answer: RefinementAnswer) -> list[str]:
    """The ladder, the verdict with notes, and what became of theta and of the decision on the device."""
    rungs = answer.ladder
    modal = answer.candidates_left is not UNSET
    if modal:
        lines = _modal_ladder(rungs)
    elif all(rung.error_fit is None for rung in rungs):
        lines = _volts_ladder(rungs)
    else:
        lines = _error_ladder(rungs)
    lines += [
        f"{_name(rung)} is partial: {support_words(rung)}" for rung in rungs if rung.status == "partial" and not modal
    ]
    lines.append(_verdict(answer, any(rung.error_fit is not None for rung in rungs)))
    lines += notes(answer)
    if answer.theta_before_deg and answer.theta_deg:
        ends = [f"{with_sd(theta, sd)} deg" for theta, sd in (answer.theta_before_deg, answer.theta_deg)]
        lines.append(f"theta {ends[0]} before, {ends[1]} after")
    verdicts = [rung.verdict for rung in rungs if rung.verdict]
    if verdicts:
        lines.append(f"device: {verdicts[0]} before, {verdicts[-1]} after ({answer.limits or 'shipped'} limits)")
    elif answer.limits == "none":
        lines.append(NO_LIMITS)
    if answer.noise and answer.noise.from_ != "silent":
        lines.append(noise_sentence(answer.noise))
    if modal and answer.parameters:
        lines += [f"  {name:32s} {with_sd(value, sd)}" for name, (value, sd) in answer.parameters.items()]
    return lines


def _error_ladder(rungs: Sequence[RungAnswer]) -> list[str]:
    """One rung per line; the misfit as a bar on a logarithmic scale."""
    largest = max([rung.misfit_fit or 0.0 for rung in rungs] + [1.0])
    lines = ["rung                      status      error fitted  held-out   misfit"]
    for rung in rungs:
        decades = math.log10(max(rung.misfit_fit or 0.0, _NO_BAR) / _NO_BAR) / math.log10(largest / _NO_BAR)
        errors = f"{number(rung.error_fit):>12s}  {number(rung.error_validate):>8s}"
        lines.append(f"{_name(rung):24s}  {rung.status or '':10s}  {errors}   {'#' * round(_BAR * decades)}")
    return lines


def _volts_ladder(rungs: Sequence[RungAnswer]) -> list[str]:
    """One rung per line where the noise level is unknown."""
    if not rungs:
        return []
    lines = ["rung                      status      relative error   rms residual of each record"]
    for rung in rungs:
        each = ", ".join(f"{name} {volts([rms])}" for name, rms in (rung.error_v or {}).items())
        lines.append(f"{_name(rung):24s}  {rung.status or '':10s}  {number(rung.relative_error):>14s}   {each}")
    return lines


def _modal_ladder(rungs: Sequence[RungAnswer]) -> list[str]:
    """One rung per line for a modal record."""
    lines = ["rung                      status     rel. error   p of all   theta, deg          spread of four thetas"]
    for rung in rungs:
        theta = with_sd(*rung.theta_deg) if rung.theta_deg else ""
        spread = f"{rung.theta_spread_deg:.2f} deg" if rung.four_thetas_deg else ""
        p = _p(rung.p_value) if rung.p_value is not UNSET else ""
        relative = _percent(rung.relative_error)
        lines.append(f"{_name(rung):24s}  {rung.status or '':10s} {relative:>9s}   {p:>8s}   {theta:18s}  {spread}")
    return lines


def _verdict(answer: DiagnosisAnswer | RefinementAnswer, noise_known: bool) -> str:
    ladder = answer.ladder if isinstance(answer, RefinementAnswer) else None
    verdict_text = missing_sentence(
        answer.verdict,
        answer.effects,
        answer.classes,
        added=ladder is not None,
        tried=tuple(rung.effect for rung in ladder or () if rung.effect),
        imitating=answer.imitating,
        noise_known=noise_known,
        louder=answer.noise_louder or None,
        data="residues" if answer.declared is not UNSET else "records",
    )
    return f"{answer.verdict}: {verdict_text}"


def _device(answer: ComparisonAnswer | DiagnosisAnswer) -> list[str]:
    """The verdict on the device by the user's limits."""
    if not answer.device_verdict:
        return []
    why = f" ({reason_words(answer.device_verdict_reason)})" if answer.device_verdict_reason else ""
    return [f"device: {answer.device_verdict} by the given limits{why}"]


def _place(place: Place) -> str:
    share = f"  {100.0 * place.share:5.1f} % of the misfit:"
    error = f"{_percent(place.relative_error)} of the mode" if place.relative_error else number(place.error)
    return f"{share} {place_words(place)}, error {error}"


def _test(one: CandidateAnswer) -> str:
    if not one.F_dof:
        return f"delta chi2 {number(one.delta_chi2)}, p {_p(one.p_value)}"
    parameters, left = one.F_dof
    statistic = f"chi2/{parameters}" if left is None else f"F({parameters}, {left})"
    return f"{statistic} = {one.F:6.2f}, p {_p(one.p_single or None)} alone, {_p(one.p_value)} among all"


def _sizes(estimate: Values) -> str:
    return ", ".join(f"{name} = {with_sd(value, sd)}" for name, (value, sd) in estimate.items())


def _name(rung: RungAnswer) -> str:
    return rung.effect or "(the given model)"


def _percent(share: float | None) -> str:
    return "unknown" if share is None else f"{100.0 * share:.1f} %"


def _p(p_value: float | None) -> str:
    return "unknown" if p_value is None else f"{p_value:.2g}" if p_value >= 1e-99 else "< 1e-99"
