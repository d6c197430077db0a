"""The preview of moved limits against the judgement itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from pipeline.errors import UsageError
from reports.limits import Limits, load_limits
from workflows.explore.night.file import moved, toml_of
from workflows.explore.night.judged import as_stored, judged_by, preview
from workflows.explore.night.stored import NightData, load

from .conftest import NIGHT, made_night

#: Quantities of a run, and the range of its devices.
RANGES = {"f1_hz": (517.0, 538.0), "split_hz": (0.5, 6.0), "rate_bias_dps": (-40.0, 40.0), "quality1": (800.0, 3000.0)}


@pytest.fixture(scope="module")
def stored(night: Path) -> NightData:
    return load(night)


def agree(found: NightData, limits: Limits, moving: str) -> None:
    shown = preview(found, limits, moving, None)[0]
    if not found.status(limits).equals("ok").any():
        # Limits so narrow that the gate refuses every device.
        assert shown.total.undecided == len(found.devices)
        with pytest.raises(UsageError, match="no device of the run can be judged"):
            judged_by(found.results, found.run_id, limits)
        return
    exact = judged_by(found.results, found.run_id, limits)
    assert shown.codes.tolist() == exact.codes.tolist()
    assert shown.total == exact.total
    if not limits.rule.by_estimate:
        known = np.isfinite(exact.p_pass)
        assert shown.p_pass[known] == pytest.approx(exact.p_pass[known], abs=1e-12)


@settings(max_examples=12)
@given(data=st.data())
def test_the_preview_is_the_judgement(stored: NightData, data: Any) -> None:
    limits, moving = stored.limits, "f1_hz"
    for _ in range(data.draw(st.integers(1, 3))):
        moving = data.draw(st.sampled_from(sorted(RANGES)))
        ends = sorted(data.draw(st.floats(*RANGES[moving])) for _ in range(2))
        keep = data.draw(st.sampled_from(["both", "low", "high"]))
        low, high = ends[0] if keep != "high" else -np.inf, ends[1] if keep != "low" else np.inf
        limits = moved(limits, moving, low, high)
    agree(stored, limits, moving)


def test_verdicts_differ_between_the_limits_that_are_tried(stored: NightData) -> None:
    tight = moved(stored.limits, "f1_hz", 529.0, 533.0)
    before, after = as_stored(stored).codes, preview(stored, tight, "f1_hz", None)[0].codes
    assert len(set(before.tolist())) > 1
    assert (before != after).any()


def test_an_arc_across_90_deg(stored: NightData) -> None:
    agree(stored, moved(stored.limits, "theta_deg", 40.0, 130.0), "theta_deg")


def test_a_limit_that_is_removed(stored: NightData) -> None:
    agree(stored, moved(stored.limits, "split_hz", -np.inf, np.inf), "split_hz")


def test_the_limits_of_the_run_give_the_run(stored: NightData) -> None:
    limits = load_limits({"limits": NIGHT["limits"]})
    assert limits == stored.limits
    assert preview(stored, limits, "f1_hz", None)[0].total == as_stored(stored).total


def test_what_does_not_move_is_kept(stored: NightData) -> None:
    first = preview(stored, moved(stored.limits, "f1_hz", 530.0, 540.0), "f1_hz", None)[1]
    further = moved(stored.limits, "f1_hz", 531.0, 540.0)
    shown, second = preview(stored, further, "f1_hz", first)
    assert second is first
    assert shown.codes.tolist() == judged_by(stored.results, stored.run_id, further).codes.tolist()


@pytest.mark.parametrize("rule", ["simple", {"name": "guard_band", "k": 2.0}])
def test_rules_by_estimate_and_a_gate_that_depends_on_the_limits(tmp_path: Path, rule: Any) -> None:
    gate = {"bias_fraction": 0.06, "theta_bias_max_deg": 2.0}
    table = {**NIGHT, "run": {"devices": 8, "seed": 5}, "rule": rule, "gate": gate}
    stored = load(made_night(tmp_path, table))
    for low, high in ((530.0, 539.0), (534.5, 535.5), (500.0, 560.0)):
        agree(stored, moved(stored.limits, "f1_hz", low, high), "f1_hz")


def test_without_stored_draws(tmp_path: Path) -> None:
    posterior = {**NIGHT["posterior"], "stored_draws": 0}
    stored = load(made_night(tmp_path, {**NIGHT, "run": {"devices": 6, "seed": 5}, "posterior": posterior}))
    agree(stored, moved(stored.limits, "f1_hz", 531.0, 538.0), "f1_hz")


def test_the_file_states_the_limits(stored: NightData, tmp_path: Path) -> None:
    limits = moved(stored.limits, "theta_deg", 80.0, 100.0)
    path = tmp_path / "new.toml"
    path.write_text(toml_of(limits), encoding="utf-8")
    assert load_limits(path) == limits
