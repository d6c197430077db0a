"""Sweeps and frequency responses beside a fitted model, as the pages take them."""

from __future__ import annotations

import numpy as np

from pipeline.criticism.problem import FitResult
from pipeline.learning.tones.problem import ToneProblem
from reports.learning.tone_view import ToneView


def tone_views(problem: ToneProblem, fit: FitResult) -> list[ToneView]:
    """Each pass of every record with the prediction of a fit, sorted by record and level."""
    predicted, found = problem.predicted(fit), []
    for one in sorted(problem.rows.passes, key=lambda own: (own.record, own.level, own.first)):
        record, rows = problem.campaign.records[one.record], one.rows
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
                np.asarray(left / problem.noise.sd_v[one.record][rows] / np.sqrt(2.0)),
            )
        )
    return found
