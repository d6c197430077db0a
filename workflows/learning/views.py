"""Sweeps and frequency responses beside a fitted model, as the pages take them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.criticism.problem import FitResult
from pipeline.learning.joint.problem import JointProblem
from pipeline.learning.tones.part import TonePart
from reports.learning.tone_view import ToneView


def tone_views(problem: JointProblem, fit: FitResult) -> list[ToneView]:
    """Each pass of every sweep and frequency response with the prediction of a fit, sorted by record and level."""
    values, found = problem.values(fit), []
    for part in problem.parts:
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
