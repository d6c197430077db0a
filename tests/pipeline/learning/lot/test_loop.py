"""The loop on tables of two quantities, where lots are made by numpy alone."""

import numpy as np
import pytest

from pipeline.criticism.budget import ALPHA
from pipeline.learning.lot.diagnosis import candidates_of, diagnosed, kind_of, mixtures_of
from pipeline.learning.lot.forecast import forecast
from pipeline.learning.lot.generic import generic_irregularities
from pipeline.learning.lot.loop import first_rung, refined
from pipeline.learning.lot.measured import MeasuredLot, hold_out
from pipeline.learning.lot.population import nested_population
from pipeline.learning.lot.prepared import prepared
from pipeline.learning.lot.respond import comparison, diagnosis, refinement

PITCH = 8.0


def table(seed: int, hidden: str = "", size: float = 0.0) -> MeasuredLot:
    """4 lots x 4 wafers x 24 dies; y0 and y1 with nested spreads, and a hidden pattern in y1."""
    g = np.random.default_rng(seed)
    places = np.array([(i, j) for i in range(-5, 6) for j in range(-5, 6) if np.hypot(i, j) <= 5.5]) * PITCH
    rows = []
    for lot in range(4):
        a = g.normal(size=2)
        for wafer in range(4):
            b = 0.7 * g.normal(size=2)
            bow = g.normal()
            for x, y in places[g.choice(len(places), 24, replace=False)]:
                rho2 = (x * x + y * y) / 44.0**2
                shape = {
                    "": 0.0,
                    "fixed_bow": rho2 - 0.5,
                    "bow": bow * (rho2 - 0.5),
                    "two_theta": (x * x - y * y) / 44.0**2,
                    "drift": (4 * lot + wafer) / 15.0 - 0.5,
                    "outliers": 8.0 * (g.random() < 0.03),
                    "spokes": np.sign(np.sin(3.0 * np.arctan2(y, x)) + 1e-9),
                }[hidden]
                e = g.normal(size=2)
                rows.append((lot, wafer, x, y, a[0] + b[0] + e[0], a[1] + b[1] + e[1] + size * shape))
    lots, wafers, x, y, y0, y1 = (np.array(column) for column in zip(*rows))
    n = len(rows)
    return hold_out(
        MeasuredLot(
            "table", ("y0", "y1"), ("nm", "1"), np.stack([y0, y1], 1), np.zeros((n, 2, 2)),
            {"lot": tuple(map(str, lots)), "wafer": tuple(map(str, wafers))}, x, y, 44.0, np.full(n, np.nan),
            tuple(map(str, range(n))),
        )
    )  # fmt: skip


@pytest.mark.parametrize(("hidden", "size"), [("fixed_bow", 1.5), ("bow", 2.5), ("two_theta", 2.0), ("outliers", 1.0)])
def test_a_hidden_pattern_is_named(hidden, size):
    lot = table(3, hidden, size)
    ladder = refined(prepared(lot, nested_population(lot)))
    assert [kind_of(name) for name in ladder.added] == [hidden]
    assert hidden == "outliers" or ladder.added[0].endswith("(y1)")
    assert ladder.verdict == "adequate"
    first, last = ladder.rungs[0], ladder.rungs[-1]
    assert last.delta_deviance > 9.2
    if hidden != "outliers":  # outliers of held-out wafers come as a surprise
        assert last.outcome.log_score_validate > first.outcome.log_score_validate


def test_testers_that_disagree_are_named():
    lot = table(8)
    g = np.random.default_rng(8)
    tester = g.integers(0, 6, len(lot.device))
    object.__setattr__(lot, "values", lot.values + np.stack([0.0 * tester, g.normal(size=6)[tester]], 1))
    object.__setattr__(lot, "labels", {**lot.labels, "tester": tuple(map(str, tester))})
    ladder = refined(prepared(lot, nested_population(lot)))
    assert ladder.added == ("tester_offset(y1)",)
    assert ladder.verdict == "adequate"


def test_a_pattern_of_no_library_is_unknown():
    lot = table(5, "spokes", 1.0)
    ladder = refined(prepared(lot, nested_population(lot)))
    assert ladder.verdict == "unknown"
    assert any("y1" in score.name for score in ladder.last.structure)


def test_p_values_are_uniform_where_nothing_is_hidden():
    """Smallest family-wise p of 40 lots: below 0.3 in 12 +- 3; 4 sd around, and none is named."""
    smallest = []
    for seed in range(40):
        lot = table(100 + seed)
        ready = prepared(lot, nested_population(lot))
        rung = first_rung(ready)
        found = diagnosed(ready, rung.fit, candidates_of(ready, rung.model), (), seed)
        smallest.append(min(score.p_value for score in (*found.candidates, *found.probes)))
        assert not found.significant
    assert abs(np.mean(np.array(smallest) < 0.3) - 0.3) < 4.0 * np.sqrt(0.3 * 0.7 / 40)
    assert min(smallest) > ALPHA / 10


def test_forecasts_cover():
    """90 % forecast of the yield of held-out wafers, 60 lots; binomial 3 sd: 78 to 100 %."""
    inside = 0
    for seed in range(60):
        lot = table(300 + seed)
        ready = prepared(lot, nested_population(lot))
        rung = first_rung(ready)
        found = forecast(
            ready.whole, rung.model, rung.fit.drawn, (),
            lambda values: (np.abs(values[..., 0]) < 1.5) & (values[..., 1] < 1.0), lot.values, seed,
        )  # fmt: skip
        assert found is not None
        inside += found.inside
    assert abs(inside / 60 - 0.9) < 3.0 * np.sqrt(0.09 / 60)


def test_answers_of_a_table_without_population():
    lot = table(3, "fixed_bow", 1.5)
    ready = prepared(lot, nested_population(lot))
    compared = comparison(ready)
    assert compared.error is None
    assert compared.as_predicted is None
    assert compared.fit_ok
    assert 0.9 < compared.refitted.error["validate"] < 1.1
    assert compared.where[0].part == "fixed_bow(y1)"
    assert set(compared.calibration) == {"y0", "y1"}
    diagnosed_ = diagnosis(ready)
    assert diagnosed_.verdict in ("effect", "class")
    assert "fixed_bow(y1)" in diagnosed_.irregularities
    answer, _ = refinement(ready, lambda values: values[..., 1] < 1.0)
    assert [rung.model for rung in answer.ladder] == ["refitted", "with fixed_bow(y1)"]
    assert all(rung.forecast is not None and 0.0 <= rung.forecast.mean <= 1.0 for rung in answer.ladder)


def test_what_a_table_lacks_is_no_candidate():
    lot = table(1)
    object.__setattr__(lot, "x_mm", np.full(len(lot.device), np.nan))
    ready = prepared(lot, nested_population(lot))
    kinds = {kind_of(part.name) for part in candidates_of(ready, first_rung(ready).model)}
    assert "fixed_bow" not in kinds
    assert "tester_offset" not in kinds
    assert {"drift", "correlation"} <= kinds
    assert [one.name for one in mixtures_of(ready)] == ["outliers"]


def test_every_generic_irregularity_is_documented():
    for name, one in generic_irregularities().items():
        assert one.name == name
        assert one.meaning[0].islower() or one.meaning[0] == "a"
