"""What the answers for campaigns and for modal records share: candidates, classes, verdict and ladder, from criticism."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import UNSET
from msgspec.structs import replace

from ..criticism.goodness import Agreement
from ..criticism.ladder import Diagnosis, Ladder, Rung
from ..criticism.problem import Problem
from ..criticism.scores import Score
from ..criticism.verdict import TermClass, misfit
from .answers import CandidateAnswer, DiagnosisAnswer, RefinementAnswer, RungAnswer, SizeDisagreement, place_at
from .next_experiment.separating import Proposal


def diagnosis_answer(found: Diagnosis) -> DiagnosisAnswer:
    """A diagnosis without what only one kind of measurement has."""
    number = {name: k for k, item in enumerate(found.classes) for name in item.members}
    return DiagnosisAnswer(
        verdict=found.verdict,
        effects=found.terms,
        candidates=tuple(
            _candidate(score, found.error_after.get(score.name), number.get(score.name)) for score in found.scores
        ),
        classes=classes_of(found.classes),
        invisible=found.invisible,
        error={} if found.fit is None else {role: found.fit.error_of(role) for role in ("fit", "validate")},
        p_left=None if found.after is None else found.after.p_value,
        left="" if found.after is None or found.after.worst is None else found.after.worst.where,
        wrong_form=_disagreements(found.wrong_form),
        why=found.why,
    )


def refinement_answer(ladder: Ladder, problem: Problem) -> RefinementAnswer:
    """A ladder without what only one kind of measurement has; ``problem`` keeps its fits."""
    answer = RefinementAnswer(
        ladder=tuple(_rung(rung) for rung in ladder.rungs),
        verdict=ladder.verdict,
        effects=ladder.terms,
        classes=classes_of(ladder.classes),
        wrong_form=_disagreements(ladder.wrong_form),
        refused=dict(ladder.refused),
        regions=tuple(
            place_at(w.labels, kind=w.family, share=w.share, error=w.error, explained=share)
            for w, share in ladder.regions
        ),
        p_left=ladder.p_left,
        left=ladder.left,
        why=ladder.why,
    )
    if not ladder.rungs:
        return answer
    first, last = problem.fit(()), problem.fit(ladder.terms)
    return replace(
        answer,
        theta_before_deg=first.derived.get("theta_deg", UNSET),
        split_before_hz=first.derived.get("split_hz", UNSET),
        theta_deg=last.derived.get("theta_deg", UNSET),
        split_hz=last.derived.get("split_hz", UNSET),
        parameters=dict(last.parameters),
    )


def classes_of(found: Sequence[TermClass]) -> tuple[tuple[str, ...], ...]:
    """Members of every class of more than one effect."""
    return tuple(item.members for item in found if len(item.members) > 1)


def separating_text(found: Sequence[Proposal], written: bool) -> str | None:
    """``separating_record`` of the JSON, with the names of the drive files if they are ``written``; ``None`` without a class."""
    if len(found) == 1:
        return found[0].text(written)
    return "; ".join(f"{' or '.join(one.members)}: {one.text(written)}" for one in found) or None


def _rung(rung: Rung) -> RungAnswer:
    return RungAnswer(
        effect=rung.term,
        status=rung.status,
        error_fit=rung.error_fit,
        error_validate=rung.error_validate,
        misfit_fit=misfit(rung.error_fit),
        misfit_validate=misfit(rung.error_validate),
        relative_error=rung.relative_error,
        delta_chi2=rung.delta_chi2,
        explained=rung.explained,
        held_out_fall=rung.held_delta_chi2,
        held_out_sd=rung.held_sd,
        terms=rung.terms,
        dropped=rung.dropped,
        parameters=dict(rung.parameters),
        derived=dict(rung.derived),
    )


def _candidate(score: Score, error_after: float | None, number: int | None) -> CandidateAnswer:
    return CandidateAnswer(
        effect=score.name,
        delta_chi2=score.delta_chi2,
        p_value=score.p_value,
        estimate={name: (v, None if math.isnan(sd) else sd) for name, (v, sd) in score.estimate.items()},
        error_after=error_after,
        class_=number,
        detectable=score.detectable,
        surviving_share=score.surviving_share,
        snr_at_reach=None if math.isinf(score.snr_at_reach) else score.snr_at_reach,
    )


def _disagreements(found: Mapping[str, Agreement]) -> dict[str, SizeDisagreement]:
    return {term: SizeDisagreement(by=one.partition, log_p=one.log_p) for term, one in found.items()}
