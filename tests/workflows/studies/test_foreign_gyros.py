"""Gyros that are not the paper's, from a simulator that shares no code: a small sample of ``benchmark foreign-gyros``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.experiment.campaign import read_campaign, write_campaign
from pipeline.experiment.checks.check import check
from workflows.studies.coverage import Share
from workflows.studies.foreign_gyros import KINDS, draw_gyro, drawn, figures, foreign_campaign, study_row


@pytest.mark.parametrize("kind", KINDS)
def test_theta_and_split_of_foreign_gyros_lie_where_their_intervals_say(kind):
    # Records of a high Q are long; the study has them.
    short = [n for n in range(20) if (gyro := drawn(3, kind, n)[0]).duration_s * gyro.rate_hz < 12_000][:2]
    rows = [study_row(3, (kind, number)) for number in short]
    assert [row["status"] for row in rows] == ["ok"] * 2
    # 4 errors of unit variance: their rms is below 2.15 with a probability of 0.999.
    z = np.array([row[name]["z"] for row in rows for name in ("theta_deg", "split_hz")])
    assert np.sqrt(np.mean(z**2)) < 2.15


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


# The second has a Q of 37,000: a chirp of 120,000 samples passes its modes at three quarters of its length.
@pytest.mark.parametrize(("kind", "declared", "seed"), [("both", "displacement", 0), ("displacement", "velocity", 109)])
def test_check_tells_a_pickoff_of_the_other_kind_from_a_lag_and_from_inverted_channels(tmp_path, kind, declared, seed):
    random = np.random.default_rng([seed])
    right = foreign_campaign(draw_gyro(random), kind, random)
    write_campaign(replace(right, instrument=right.instrument.with_pickoff(declared)), tmp_path)
    (found,) = check(read_campaign(tmp_path)).findings
    assert found.kind == "pickoff"
    assert found.correction.toml.strip() == f'[device]\npickoff = "{right.instrument.pickoff}"'
    # What check advises is read back, and leaves nothing to find.
    text = (tmp_path / "campaign.toml").read_text().replace('pickoff = "displacement"\n', "")
    (tmp_path / "campaign.toml").write_text(text.replace("[device]\n", found.correction.toml, 1))
    assert check(read_campaign(tmp_path)).findings == ()
