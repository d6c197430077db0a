"""Errors of theta and split beside their Cramer-Rao bounds, in a sample of the study ``gyroscreen benchmark efficiency``."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from pipeline.errors import UsageError
from workflows.studies.efficiency import BLOCK, figures, rms_with_interval, run_study, study_row


@pytest.mark.parametrize("cell", ["40dB-0.1Hz", "80dB-10Hz"])
def test_errors_have_the_spread_of_their_bound_at_the_corners_of_the_study(cell: str) -> None:
    row = study_row(3, (cell, 0))
    assert row["not_fitted"] == 0
    for name in ("z_theta", "z_split"):
        total = float(np.sum(np.square(row[name])))
        # 1e-4 in each tail: four sums in all.
        assert chi2.ppf(1e-4, BLOCK) < total < chi2.ppf(1.0 - 1e-4, BLOCK), name


def test_the_interval_of_an_rms_covers_its_truth_as_often_as_stated() -> None:
    random = np.random.default_rng(5)
    inside = 0
    for _ in range(2000):
        text = rms_with_interval(random.standard_normal(30).tolist())
        low, high = (float(one) for one in text.split("(")[1].rstrip(")").split(" to "))
        inside += low <= 1.0 <= high
    # 95 % of 2000 within 4 sd.
    assert abs(inside - 1900) < 4.0 * np.sqrt(2000 * 0.95 * 0.05)


def test_cells_without_rows_have_no_figures_and_unknown_cells_are_refused(tmp_path) -> None:
    row = {"kind": "60dB-1Hz", "number": 0, "seed": 1, "not_fitted": 1, "z_theta": [1.0] * 49, "z_split": [2.0] * 49}
    found = figures([row])
    assert set(found) == {
        "60dB, 1Hz: rms (theta - truth)/CRLB", "60dB, 1Hz: rms (split - truth)/CRLB", "60dB, 1Hz: not fitted",
    }  # fmt: skip
    assert str(found["60dB, 1Hz: rms (split - truth)/CRLB"]).startswith("2.000")
    with pytest.raises(UsageError, match="no such kind"):
        list(run_study(["50dB-1Hz"], 50, 1, tmp_path, 1))
