"""Answers, and records beside the fitted models, as the pages take them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.criticism.problem import FitResult
from pipeline.experiment.record import Campaign
from pipeline.inference.general.fit import CampaignFit
from pipeline.learning.answers import ComparisonAnswer, DiagnosisAnswer, RefinementAnswer
from pipeline.learning.campaign.problem import CampaignProblem
from pipeline.learning.envelopes.part import EnvelopePart
from pipeline.learning.joint.problem import JointProblem
from pipeline.learning.timed.part import TimePart
from pipeline.learning.tones.part import TonePart
from reports.learning.decay_view import DecayView
from reports.learning.record_view import RecordView
from reports.learning.tone_view import ToneView

from . import ComparisonResult, DiagnosisResult, RefinementResult, Result


@dataclass(frozen=True, eq=False)
class PageViews:
    """What the page of a result shows: answers; records and tones with the first model and, after refine, with the last one."""

    comparison: ComparisonAnswer
    diagnosis: DiagnosisAnswer | None
    refinement: RefinementAnswer | None
    before: list[RecordView]
    after: list[RecordView] | None
    tones: list[ToneView]
    tones_after: list[ToneView]


def views_of(found: Result) -> PageViews:
    """The content of the page of a result."""
    problem, first = found.problem, ComparisonResult(found.answers)
    diagnosis = refinement = after = None
    tones_after: list[ToneView] = []
    if isinstance(found, DiagnosisResult):
        diagnosis = found.answer
    if isinstance(found, RefinementResult):
        diagnosis, refinement = found.first_diagnosis, found.answer
        after, tones_after = records_of(problem, found.after), tones_of(problem, found.after)
    before, tones = records_of(problem, first.fit), tones_of(problem, first.fit)
    return PageViews(first.answer, diagnosis, refinement, before, after, tones, tones_after)


def records_of(problem: object, fit: CampaignFit | FitResult) -> list[RecordView]:
    """Each driven record in the time domain with the prediction of a fit; none for a modal record."""
    if isinstance(problem, JointProblem) and isinstance(fit, FitResult):
        return joint_record_views(problem, fit)
    if isinstance(problem, CampaignProblem) and isinstance(fit, CampaignFit):
        return record_views(problem.measured, fit)
    return []


def tones_of(problem: object, fit: CampaignFit | FitResult) -> list[ToneView]:
    """Each pass of a sweep and each frequency response, with the prediction of a fit."""
    return tone_views(problem, fit) if isinstance(problem, JointProblem) and isinstance(fit, FitResult) else []


def record_views(campaign: Campaign, fit: CampaignFit) -> list[RecordView]:
    """Each driven record in the time domain with the prediction of a fit."""
    records = {record.name: record for record in campaign.records}
    return [
        RecordView(
            r.name, str(r.role), records[r.name].sample_rate_hz, records[r.name].drive_v, records[r.name].sense_v,
            r.predicted_v, r.residual, r.error,
        )
        for r in fit.records
    ]  # fmt: skip


def joint_record_views(problem: JointProblem, fit: FitResult) -> list[RecordView]:
    """The same for a campaign that has other records as well."""
    values = problem.values(fit)
    return [
        view
        for part in problem.parts_of(fit)
        if isinstance(part, TimePart)
        for view in record_views(part.campaign, part.fit_at(values))
    ]


def tone_views(problem: JointProblem, fit: FitResult) -> list[ToneView]:
    """Each pass of every sweep and frequency response with the prediction of a fit, sorted by record and level."""
    values, found = problem.values(fit), []
    for part in problem.parts_of(fit):
        if isinstance(part, TonePart):
            found += _passes(part, values)
    return found


def _passes(part: TonePart, values: Mapping[str, float]) -> list[ToneView]:
    predicted, found = part.predicted(values), []
    for one in sorted(part.rows.passes, key=lambda own: (own.record, own.level, own.first)):
        record, rows = part.campaign.records[one.record], one.rows
        left = np.abs(record.sense_v[rows] - predicted[one.record][rows])
        found.append(
            ToneView(
                record.name,
                f"{one.direction}, level {one.level:.3g}" if record.kind == "sweep" else f"drive {one.drives}",
                str(record.role),
                record.frequency_hz[rows],
                record.level_v[rows],
                record.sense_v[rows],
                predicted[one.record][rows],
                np.asarray(left / part.rows.noise.sd_v[one.record][rows] / np.sqrt(2.0)),
            )
        )
    return found


def decays_of(problem: object, fit: CampaignFit | FitResult) -> list[DecayView]:
    """The amplitudes of each free decay, with the prediction of a fit."""
    if not (isinstance(problem, JointProblem) and isinstance(fit, FitResult)):
        return []
    values = problem.values(fit)
    parts = (part for part in problem.parts_of(fit) if isinstance(part, EnvelopePart))
    return [view for part in parts for view in _decays(part, values)]


def _decays(part: EnvelopePart, values: Mapping[str, float]) -> list[DecayView]:
    found = []
    for record, noise, own in zip(part.records, part.row_noise, part.predicted(values)):
        scores = [(record.amplitude_v - own.amplitude_v) / noise.amplitude_v]
        for measured, model, sd in (
            (record.phase_rad, own.phase_rad, noise.phase_rad),
            (record.frequency_hz, own.frequency_hz, noise.frequency_hz),
        ):
            if measured is not None and model is not None and sd is not None:
                # Where a phase is lost, its sd is infinite, and the amplitude alone counts.
                score = np.where(np.isfinite(sd), (measured - model) / sd, np.nan)
                scores.append(_columns(score, record.amplitude_v.shape[1]))
        known = np.isfinite(scores)
        square = np.sum(np.where(known, scores, 0.0) ** 2, axis=0) / np.maximum(known.sum(axis=0), 1)
        found.append(
            DecayView(
                record.name,
                str(record.role or "fit"),
                record.time_s,
                record.amplitude_v,
                own.amplitude_v,
                np.asarray(np.sqrt(square)),
            )
        )
    return found


def _columns(score: FloatArray, senses: int) -> FloatArray:
    """(N, S) of a score of each row (N,) or of each sense (N, S)."""
    return np.broadcast_to(score.reshape(score.shape[0], -1), (score.shape[0], senses))
