"""Gyros that are not the paper's, from a simulator that shares no code: a small sample of ``benchmark foreign-gyros``."""

from __future__ import annotations

import numpy as np
import pytest

from workflows.studies.coverage import Share
from workflows.studies.foreign_gyros import KINDS, draw_gyro, figures, study_row


@pytest.mark.parametrize("kind", KINDS)
def test_theta_and_split_of_foreign_gyros_lie_where_their_intervals_say(kind):
    rows = [study_row(3, (kind, number)) for number in range(5)]
    assert [row["status"] for row in rows] == ["ok"] * 5
    # 20 errors of unit variance: their rms is below 1.6 with a probability of 0.9999.
    z = np.array([row[name]["z"] for row in rows for name in ("theta_deg", "split_hz")])
    assert np.sqrt(np.mean(z**2)) < 2.0


def test_the_drawn_gyros_fill_the_stated_ranges():
    gyros = [draw_gyro(np.random.default_rng(seed)) for seed in range(300)]
    first, quality = (np.array(values) for values in zip(*((g.frequency_hz[0], g.quality[0]) for g in gyros)))
    assert first.min() < 250.0
    assert first.max() > 40_000.0
    assert quality.min() < 70.0
    assert quality.max() > 70_000.0
    for g in gyros:
        assert g.split_hz >= 0.02 * g.frequency_hz[0] / g.quality[0] * 0.79
        assert g.low_hz < min(g.frequency_hz) < max(g.frequency_hz) < g.high_hz < g.rate_hz / 2.0


def test_figures_count_only_what_was_identified():
    def row(status, inside):
        return {"status": status, "cpu_seconds": 1.0, "theta_deg": {"inside": inside}, "split_hz": {"inside": True}}

    found = figures([row("ok", True), row("ok", False), row("misfit", False)])
    assert found["status ok"] == Share(2, 3)
    assert found["theta inside its 90 % interval"] == Share(1, 2)
