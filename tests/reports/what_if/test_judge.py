"""Draws judged again: against the decision itself, limit by limit, and against the weights' definition."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.axial import wrap
from pipeline.store.schema import devices_table
from reports.coded import coded
from reports.decision import decide
from reports.devices import Devices
from reports.limits import Limit, Limits
from reports.rules import Rule
from reports.what_if.changes import difference
from reports.what_if.content import WhatIf, what_if
from reports.what_if.draws import DrawBatch, contains, pairs_of, reweighted
from reports.what_if.judge import Again, judge_again
from reports.what_if.table import replaced

N, DRAWS = 60, 40
OLD = Limits(
    Rule(),
    (Limit("split_hz", -math.inf, 1.0), Limit("f1_hz", -1.0, 1.5), Limit("theta_deg", 70.0, 110.0)),
)
NEW = Limits(
    Rule(pass_at=0.9),
    (
        Limit("split_hz", -0.8, 1.2),
        Limit("f1_hz", -1.5, math.inf),
        Limit("theta_deg", 75.0, 130.0),
        Limit("zeta1", -2.0, 1.0),
    ),
)
NAMES = ("split_hz", "f1_hz", "theta_deg", "zeta1")


def _draws(seed: int = 1) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=(4, N, 1))
    draws = dict(zip(NAMES, centre + 0.4 * rng.normal(size=(4, N, DRAWS)), strict=True))
    # An axis about 90 deg, on both sides of the end of its range.
    draws["theta_deg"] = wrap(90.0 + 15.0 * draws["theta_deg"])
    return draws


def _devices(draws: dict[str, np.ndarray], limits: Limits, status: str = "ok", p_pass: Any = None) -> Devices:
    found = decide(limits, draws, [status] * N)
    columns: dict[str, Any] = {
        "device_id": [f"D{i:03d}" for i in range(N)], "lot": ["L1"] * N, "wafer": [f"W{i % 4}" for i in range(N)],
        "status": [status] * N, "verdict": list(found.verdict), "failed_limits": list(found.failed_limits),
        "p_pass": found.p_pass if p_pass is None else p_pass,
    }  # fmt: skip
    for name, values in draws.items():
        columns |= {name: np.median(values, axis=1), f"{name}_sd": np.std(values, axis=1)}
    away = wrap(draws["theta_deg"] - 90.0)
    columns |= {"theta_deg": wrap(90.0 + np.median(away, axis=1)), "theta_deg_sd": np.std(away, axis=1)}
    return Devices(devices_table(columns))


def _again(devices: Devices, draws: dict[str, np.ndarray], old: Limits = OLD, new: Limits = NEW) -> Again:
    batches = [DrawBatch(rows, {q: v[rows] for q, v in draws.items()}) for rows in np.array_split(np.arange(N), 3)]
    return judge_again(devices, old, new, devices.text("status"), batches, devices.wafers())


def test_all_draws_give_the_decision_itself() -> None:
    draws = _draws()
    again, expected = _again(_devices(draws, OLD), draws), decide(NEW, draws, ["ok"] * N)
    assert tuple(again.verdict) == expected.verdict
    assert tuple(again.failed_limits) == expected.failed_limits
    np.testing.assert_allclose(again.p_pass, expected.p_pass, atol=1e-12)
    assert {"pass", "fail", "undecided"} == set(expected.verdict)


def test_a_curve_is_the_yield_of_each_moved_limit() -> None:
    draws = _draws()
    again = _again(_devices(draws, OLD), draws)
    assert [(grid.end.limit.quantity, grid.end.high) for grid in again.grids] == [
        ("split_hz", False), ("split_hz", True), ("f1_hz", False), ("theta_deg", False), ("theta_deg", True),
        ("zeta1", False), ("zeta1", True),
    ]  # fmt: skip
    checked = 0
    for e, grid in enumerate(again.grids):
        for g in range(0, grid.coordinates.size, 4):
            position = float(grid.end.position(grid.coordinates)[g])
            moved = [
                replace(one, **{"high" if grid.end.high else "low": position}) if one == grid.end.limit else one
                for one in NEW.limits
            ]
            here = moved[[one.quantity for one in moved].index(grid.end.limit.quantity)]
            if here.low > here.high or (here.axis and not 0.0 < here.high - here.low < 180.0):
                assert again.passed[e, g].sum() == 0 or here.axis
                continue
            expected = decide(Limits(NEW.rule, tuple(moved)), draws, ["ok"] * N).verdict
            counts = [sum(v == "pass" for v in expected[w::4]) for w in range(4)]
            assert again.passed[e, g].tolist() == counts
            checked += 1
    assert checked > 80


BY_ESTIMATE = [Rule("simple"), Rule("guard_band", k=1.0), Rule("guard_band", consumer_risk=0.2)]


@pytest.mark.parametrize("rule", [Rule(pass_at=0.9), *BY_ESTIMATE])
def test_losses_to_limits_and_pairs_are_those_without_them(rule: Rule) -> None:
    draws = _draws(2)
    new = Limits(rule, NEW.limits)
    again = _again(_devices(draws, OLD), draws, new=new)
    sets = [(), *((i,) for i in range(4)), *pairs_of(4)]
    for k, dropped in enumerate(sets):
        kept = tuple(limit for i, limit in enumerate(NEW.limits) if i not in dropped)
        expected = decide(Limits(rule, kept), draws, ["ok"] * N).verdict
        assert again.without[k] == sum(v == "pass" for v in expected), dropped
    assert again.without[-1] > again.without[0]


@pytest.mark.parametrize("rule", BY_ESTIMATE)
def test_rules_by_estimate_along_a_curve(rule: Rule) -> None:
    draws = _draws(3)
    again = _again(_devices(draws, OLD), draws, new=Limits(rule, NEW.limits))
    assert tuple(again.verdict) == decide(Limits(rule, NEW.limits), draws, ["ok"] * N).verdict
    for e, grid in ((1, again.grids[1]), (2, again.grids[2])):
        for g in (5, 30, 55):
            position = float(grid.end.position(grid.coordinates)[g])
            end = "high" if grid.end.high else "low"
            moved = tuple(replace(one, **{end: position}) if one == grid.end.limit else one for one in NEW.limits)
            if any(one.low > one.high for one in moved):
                continue
            expected = decide(Limits(rule, moved), draws, ["ok"] * N).verdict
            assert again.passed[e, g].sum() == sum(v == "pass" for v in expected)


def test_draws_are_weighted_by_what_the_run_found() -> None:
    """The run's own P(conform) is recovered at the old limits, and the weighted share has a third of the error at new ones."""
    rng = np.random.default_rng(4)
    many = {"split_hz": rng.normal(rng.normal(1.0, 0.2, (400, 1)), 0.4, (400, 2000))}
    old, new = (Limits(Rule(), (Limit("split_hz", -math.inf, at),)) for at in (1.0, 1.05))
    exact_old, exact_new = (decide(one, many, ["ok"] * 400).p_pass for one in (old, new))
    few = {"split_hz": many["split_hz"][:, :50]}
    found = reweighted(DrawBatch(np.arange(400), few), exact_old, old, new)
    plain = decide(new, few, ["ok"] * 400).p_pass
    np.testing.assert_array_equal(reweighted(DrawBatch(np.arange(400), few), exact_old, old, old).p_pass, exact_old)
    rms = [float(np.sqrt(np.mean((p - exact_new) ** 2))) for p in (found.p_pass, plain)]
    assert rms[0] < 0.6 * rms[1]
    # The sd that is reported is that of the error.
    z = (found.p_pass - exact_new) / np.maximum(found.sd, 1e-3)
    assert 0.7 < float(np.sqrt(np.mean(z[found.sd > 0.0] ** 2))) < 1.3


def test_wider_limits_never_lose_and_narrower_ones_never_gain() -> None:
    draws = _draws(5)
    wide = Limits(Rule(), (Limit("split_hz", -math.inf, 1.4), Limit("f1_hz", -1.0, 1.5)))
    assert contains(wide, OLD)
    assert not contains(OLD, wide)
    rng = np.random.default_rng(6)
    run = np.clip(decide(OLD, draws, ["ok"] * N).p_pass + rng.normal(0.0, 0.05, N), 0.0, 1.0)
    batch = DrawBatch(np.arange(N), draws)
    assert np.all(reweighted(batch, run, OLD, wide).p_pass >= run)
    assert np.all(reweighted(batch, run, wide, OLD).p_pass <= run)


def test_draws_that_are_nan_leave_a_verdict_where_both_bounds_agree() -> None:
    draws = _draws(7)
    draws["zeta1"][::2] = np.nan
    expected = decide(NEW, draws, ["ok"] * N)
    again = _again(_devices(draws, OLD), draws)
    assert tuple(again.verdict) == expected.verdict
    np.testing.assert_allclose(again.p_pass, expected.p_pass, atol=1e-12)


def test_devices_that_are_not_judged_stay_undecided() -> None:
    draws = _draws()
    devices = _devices(draws, OLD, status="misfit")
    again = judge_again(devices, OLD, NEW, devices.text("status"), (), devices.wafers())
    assert set(again.verdict) == {"undecided"}
    assert set(again.failed_limits) == {""}
    assert np.isnan(again.p_pass).all()
    assert again.passed.sum() == 0


def _content(new: Limits = NEW) -> WhatIf:
    draws = _draws()
    devices = _devices(draws, OLD)
    again = _again(devices, draws, new=new)
    texts = {"status": again.status, "verdict": again.verdict, "failed_limits": again.failed_limits}
    after = Devices(replaced(devices.table, texts, {"p_pass": again.p_pass}))
    thinning = (DRAWS, 3072, ())
    return what_if("r", devices, after, None, None, again, OLD, new, thinning, "new.toml")


def test_the_content_counts_and_names_every_changed_device() -> None:
    found = _content()
    old, new = decide(OLD, _draws(), ["ok"] * N).verdict, decide(NEW, _draws(), ["ok"] * N).verdict
    changed = {f"D{i:03d}": (a, b) for i, (a, b) in enumerate(zip(old, new, strict=True)) if a != b}
    assert {one.device_id: (one.old, one.new) for one in found.changed} == changed
    assert sum(n for a, b, n in found.transitions if a != b) == len(changed)
    assert found.total.old.passed == old.count("pass")
    assert found.total.new.passed == new.count("pass")
    assert sum(pair.new.devices for pair in found.wafers) == N
    for one in found.changed:
        assert one.by
        assert set(one.by) <= set(NAMES) | {"rule"}
    best = found.pairs[0]
    assert best.devices == max(pair.devices for pair in found.pairs)
    alone = {limit.quantity: n for limit, n in found.singles}
    assert (best.first_alone, best.second_alone) == (alone[best.first.quantity], alone[best.second.quantity])


def test_another_rule_alone_is_named_as_the_cause() -> None:
    found = _content(Limits(Rule(pass_at=0.6, fail_at=0.5), OLD.limits))
    assert found.changed
    assert {one.by for one in found.changed} == {("rule",)}
    assert [row.by for row in found.changes] == ["rule"]


def test_the_interval_of_the_difference_covers() -> None:
    """1000 pairs of verdicts of 100 devices: 95 % intervals cover the true difference of -0.1 in at least 93 %."""
    rng = np.random.default_rng(8)
    covered = 0
    for _ in range(1000):
        old = rng.random(100) < 0.7
        new = old & (rng.random(100) < 6.0 / 7.0)
        found = difference(old, new, coded([""] * 100))
        covered += found.low <= -0.1 <= found.high
    assert covered >= 930
