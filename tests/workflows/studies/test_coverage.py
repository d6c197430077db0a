"""Intervals of the nightly run cover the truth whatever the kind of the noise: a small sample of `benchmark coverage`."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import UsageError
from workflows.studies.coverage import COVERED, run_study, study_block, study_config


@pytest.mark.parametrize("noise", ["ar", "1/f", "jitter"])
def test_intervals_cover_the_truth_with_noise_of_every_kind(noise):
    rows = study_block((study_config(5, 16, noise), "population", 0.0), (0, 16))
    assert all(row.status == "ok" for row in rows)
    # Of 64 intervals 58 are expected, and 49 are 3.5 sd fewer; taken as white noise, AR(0.7) leaves 37.
    assert sum(len(row.inside & set(COVERED)) for row in rows) > 49


def test_intervals_cover_the_truth_with_bad_samples():
    rows = study_block((study_config(5, 10), "population", 0.001), (0, 10))
    assert all(row.status == "ok" for row in rows)
    assert sum(len(row.inside & set(COVERED)) for row in rows) > 30
    # A bad sample that is used moves theta by tens of Cramer-Rao sds.
    assert np.sqrt(np.mean([row.z_theta**2 for row in rows if row.split_hz >= 0.2])) < 1.5


def test_an_unknown_kind_of_noise_is_refused():
    with pytest.raises(UsageError, match="kind of noise"):
        run_study(10, "population", 1, 1, "pink")
