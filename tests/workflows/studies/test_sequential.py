"""The study of the sequential test."""

import math

from reports.limits import DEFAULT_LIMITS
from workflows.config import load_config
from workflows.studies.sequential import (
    ANALYSIS_TIMES_S,
    InterimResults,
    as_good_as,
    figures,
    fixed_test,
    sequential_test,
    study_block,
)

NAN = math.nan


def rows() -> list[InterimResults]:
    return [
        InterimResults(True, (NAN, 0.97, 0.999), {2.0: 1.0, 3.0: 1.0}),
        InterimResults(False, (0.96, 0.5, 0.0), {2.0: 0.0, 3.0: 0.0}),
        InterimResults(False, (0.5, 0.01, 0.0), {2.0: 0.0, 3.0: 0.0}),
        InterimResults(True, (0.5,) * len(ANALYSIS_TIMES_S), {2.0: 0.5, 3.0: 0.5}),
    ]


def test_the_test_stops_at_the_first_interim_analysis_beyond_a_threshold() -> None:
    found = sequential_test(rows(), 0.05)
    assert found.mean_s == (0.4 + 0.3 + 0.4 + 3.0) / 4.0
    assert (found.wrong_pass.count, found.wrong_fail.count, found.undecided.count) == (1, 0, 1)


def test_as_good_as_returns_the_loosest_threshold_with_no_more_errors_than_the_fixed_test() -> None:
    fixed = fixed_test(rows(), 2.0, 0.05)
    assert (fixed.wrong_pass.count, fixed.undecided.count) == (0, 1)
    found = as_good_as(rows(), fixed)
    assert found is not None
    threshold, test = found
    assert threshold == 0.02
    assert test.wrong_pass.count == 0


def test_virtual_devices_are_decided_without_error_within_one_second_on_average() -> None:
    config = load_config(None, {"seed": 2026, "devices": 4})
    found = study_block(config, (0, 4))
    test = sequential_test(found, DEFAULT_LIMITS.rule.fail_at)
    assert test.wrong_pass.count + test.wrong_fail.count + test.undecided.count == 0
    assert test.mean_s < 1.0
    assert {row.fixed[3.0] > 0.5 for row in found if row.conforms} == {True}
    assert figures(found, 0.05)["devices"] == 4
