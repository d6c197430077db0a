"""The study of the sequential test."""

import numpy as np
import pytest

from reports.limits import load_limits
from workflows.config import load_config
from workflows.studies.near_limits import ALONE, SEQUENTIAL, near_figures, near_verdicts
from workflows.studies.sequential import Decided, InterimResults, figures, study_block

LIMITS = load_limits({"limits": {"split_hz": {"max": 3.0}}})


def row(conforms: bool, verdict: str, time_s: float) -> InterimResults:
    late = {f"fixed {t} s": Decided("pass" if conforms else "fail", float(t)) for t in (2, 3)}
    return InterimResults(conforms, {SEQUENTIAL: Decided(verdict, time_s), ALONE: Decided(verdict, 0.3), **late})


def test_figures_count_wrong_verdicts_and_average_durations() -> None:
    found = figures(
        [row(True, "pass", 0.4), row(False, "pass", 0.3), row(True, "fail", 0.5), row(True, "undecided", 3.0)]
    )
    assert found["sequential: mean duration, s"] == pytest.approx(4.2 / 4.0)
    for name in ("wrong pass", "wrong fail", "undecided"):
        assert (found[f"sequential: {name}"].count, found[f"fixed 2 s: {name}"].count) == (1, 0)


def test_near_verdicts_are_wrong_where_the_estimate_is_beyond_the_limit_and_right_elsewhere() -> None:
    # sd 1 at both analyses; the first is off by +2.5 sd, the last by +0.5.
    unit = np.random.default_rng(1).standard_normal(100_000)
    looks = [{"split_hz": unit + 2.5}, None, {"split_hz": unit + 0.5}]
    found = {
        (v.rule, v.distance): v for v in near_verdicts(LIMITS, {"split_hz": np.float64(0.0)}, looks, (1.0, 2.0, 3.0))
    }
    # Limit above by 0.5: z = -2 at the first analysis, beyond 1.96; limit below by 0.5: z = +3, a pass.
    assert found[SEQUENTIAL, 0.5].wrong == found[ALONE, 0.5].wrong == 1
    assert found[SEQUENTIAL, 2.0].wrong == 0
    assert found[SEQUENTIAL, 4.0].times_s == (3.0, 1.0)
    assert found[SEQUENTIAL, 4.0].decided == 2
    share = near_figures([list(found.values())] * 3)["sequential, 0.5 final sd from a limit: wrong"]
    assert (share.count, share.total, share.devices) == (3, 6, 3)


def test_virtual_devices_are_decided_without_error_within_one_second_on_average() -> None:
    config = load_config(None, {"seed": 2026, "devices": 4})
    found = figures(study_block(config, (0, 4, 1)))
    for name in ("wrong pass", "wrong fail", "undecided"):
        assert found[f"sequential: {name}"].count == found[f"fixed 3 s: {name}"].count == 0
    assert found["sequential: mean duration, s"] < 1.0
    assert found["sequential, 256 final sd from a limit: decided"].total == 14
