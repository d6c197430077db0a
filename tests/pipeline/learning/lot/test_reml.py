"""Restricted maximum likelihood of a lot against published figures, MixedLM, and dense linear algebra."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.errors import MeasurementError
from pipeline.learning.lot.derivatives import derivatives
from pipeline.learning.lot.design import arranged
from pipeline.learning.lot.elimination import factorised, log_likelihood, solved
from pipeline.learning.lot.measured import MeasuredLot, hold_out
from pipeline.learning.lot.model import FixedPart, LotModel, RandomPart, means, merged
from pipeline.learning.lot.outcome import left_out
from pipeline.learning.lot.reml import centred, fitted
from tests.nested_designs import MIXED_LM, nested_design

OXIDE = Path(__file__).resolve().parents[5] / "shared" / "data" / "oxide" / "oxide.csv"


def plain_lot(y: np.ndarray, lots: list[str], wafers: list[str], radius: float = 50.0, seed: int = 0) -> MeasuredLot:
    n = len(y)
    g = np.random.default_rng(seed)
    values = y.reshape(n, -1)
    q = values.shape[1]
    names = tuple(f"y{k}" for k in range(q))
    x, z = g.uniform(-30, 30, (2, n))
    return MeasuredLot(
        "lot", names, ("1",) * q, values, np.zeros((n, q, q)), {"lot": tuple(lots), "wafer": tuple(wafers)},
        x, z, radius, np.full(n, np.nan), tuple(map(str, range(n))),
    )  # fmt: skip


def nested(lot: MeasuredLot, unit: float) -> LotModel:
    n = len(lot.device)
    parts = tuple(RandomPart(level, level, np.full((n, 1, 1), unit)) for level in ("lot", "wafer", "device"))
    return LotModel((means(n, 1),), parts, np.zeros((n, 1)))


@pytest.mark.skipif(not OXIDE.exists(), reason="the data are not beside the project")
def test_oxide_to_the_published_digits():
    data = pd.read_csv(OXIDE)
    lot = plain_lot(data.Thickness.to_numpy(float), list(data.Lot.astype(str)), list(data.Wafer.astype(str)))
    fit = fitted(lot, nested(lot, 5.0))
    assert fit.converged
    assert 5.0 * np.sqrt(fit.variances) == pytest.approx([11.398, 5.989, 3.545], abs=6e-4)
    assert fit.solution.coefficients[0, 0] == pytest.approx(2000.153, abs=6e-4)
    assert fit.log_likelihood == pytest.approx(-227.011, abs=6e-4)


@pytest.mark.parametrize("seed", sorted(MIXED_LM))
def test_nested_designs_as_mixed_lm(seed):
    rows = nested_design(seed)
    lot = plain_lot(np.array([r[2] for r in rows]), [str(r[0]) for r in rows], [str(r[1]) for r in rows])
    fit = fitted(lot, nested(lot, 1.0))
    *sds, value = MIXED_LM[seed]
    assert fit.converged
    assert np.sqrt(fit.variances) == pytest.approx(sds, abs=1e-4)
    assert fit.log_likelihood == pytest.approx(value, abs=2e-6)


def dense(lot: MeasuredLot, model: LotModel, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V (N, N) and X (N, p), element by element from the definition."""
    n, q = lot.values.shape
    whole = np.zeros((n, q, n, q))
    for i in range(n):
        whole[i, :, i, :] += lot.covariance[i]
    for part, size in zip(model.random, v):
        for i in range(n):
            for j in range(n):
                if part.level == "device":
                    shared = float(i == j)
                elif part.level == "all":
                    shared = 1.0
                else:
                    shared = float(lot.codes(part.level)[i] == lot.codes(part.level)[j])
                if part.field_mm is not None:
                    shared *= np.exp(-np.hypot(lot.x_mm[i] - lot.x_mm[j], lot.y_mm[i] - lot.y_mm[j]) / part.field_mm)
                whole[i, :, j, :] += size * shared * part.columns[i] @ part.columns[j].T
    x = np.concatenate([part.columns for part in model.fixed], axis=2)
    return whole.reshape(n * q, n * q), x.reshape(n * q, -1)


@pytest.fixture(scope="module")
def rich() -> tuple[MeasuredLot, LotModel, np.ndarray]:
    """Two quantities, all levels, a field, a fixed pattern, correlated measurement errors."""
    g = np.random.default_rng(3)
    n, q = 30, 2
    lots = [str(k // 15) for k in range(n)]
    wafers = [str(k // 5 % 3) for k in range(n)]
    lot = plain_lot(g.normal(size=(n, q)), lots, wafers, seed=4)
    root = g.normal(size=(n, q, q)) * 0.3
    object.__setattr__(lot, "covariance", root @ root.transpose(0, 2, 1) + 0.05 * np.eye(q))
    random = tuple(
        RandomPart(f"{level}{k}", level, g.normal(size=(n, q, m)), field_mm=field)
        for k, (level, m, field) in enumerate(
            [("device", 2, None), ("wafer", 1, None), ("wafer", 1, 20.0), ("lot", 2, None), ("all", 1, None)]
        )
    )
    pattern = FixedPart("bow", g.normal(size=(n, q, 1)))
    return lot, LotModel((means(n, q), pattern), random, np.zeros((n, q))), np.array([0.7, 1.3, 0.6, 0.4, 0.9])


def test_elimination_is_the_dense_likelihood(rich):
    lot, model, v = rich
    design = arranged(lot, model)
    factor = factorised(design, v)
    y = centred(lot, model)
    solution = solved(factor, y[..., None])
    whole, x = dense(lot, model, v)
    inverse = np.linalg.inv(whole)
    gram = x.T @ inverse @ x
    p = inverse - inverse @ x @ np.linalg.solve(gram, x.T @ inverse)
    flat = y.reshape(-1)
    value = -0.5 * (
        (flat.size - x.shape[1]) * np.log(2 * np.pi)
        + np.linalg.slogdet(whole)[1] + np.linalg.slogdet(gram)[1] + flat @ p @ flat
    )  # fmt: skip
    assert log_likelihood(factor, float(solution.quadratic[0])) == pytest.approx(value, abs=1e-6)
    assert solution.coefficients[:, 0] == pytest.approx(np.linalg.solve(gram, x.T @ inverse @ flat), abs=1e-7)
    out = left_out(lot, model, v)
    q = 2
    block = slice(7 * q, 8 * q)
    assert out.residual[7] == pytest.approx(np.linalg.solve(p[block, block], (p @ flat)[block]), abs=1e-6)


def test_derivatives_are_those_of_the_likelihood(rich):
    lot, model, v = rich
    design = arranged(lot, model)
    factor = factorised(design, v)
    y = centred(lot, model)[..., None]
    score, information = derivatives(factor, solved(factor, y))

    def value(trial: np.ndarray) -> float:
        other = factorised(design, trial)
        return log_likelihood(other, float(solved(other, y).quadratic[0]))

    for k in range(len(v)):
        up, down = v.copy(), v.copy()
        up[k], down[k] = v[k] * np.exp(1e-4), v[k] * np.exp(-1e-4)
        assert score[k] == pytest.approx((value(up) - value(down)) / 2e-4, abs=1e-5)
    whole, x = dense(lot, model, v)
    inverse = np.linalg.inv(whole)
    p = inverse - inverse @ x @ np.linalg.solve(x.T @ inverse @ x, x.T @ inverse)
    parts = []
    for k in range(len(v)):
        one = np.zeros_like(v)
        one[k] = v[k]
        parts.append(dense(lot, model, one)[0] - dense(lot, model, 0.0 * v)[0])
    flat = y.reshape(-1)
    wanted = [[0.5 * flat @ p @ a @ p @ b @ p @ flat for b in parts] for a in parts]
    assert information == pytest.approx(np.array(wanted), rel=1e-5, abs=1e-8)


def test_intervals_of_balanced_lots_cover():
    """90 % intervals of a device spread and of a wafer spread, 200 lots; binomial 3 sd: 83.6 to 96.4 %."""
    inside = np.zeros(2)
    for seed in range(200):
        g = np.random.default_rng(seed)
        wafer = np.repeat(np.arange(12), 8)
        y = 2.0 * g.normal(size=12)[wafer] + g.normal(size=96)
        lot = plain_lot(y, ["a"] * 96, [str(w) for w in wafer])
        n = 96
        parts = tuple(RandomPart(level, level, np.ones((n, 1, 1))) for level in ("wafer", "device"))
        ends = fitted(lot, LotModel((means(n, 1),), parts, np.zeros((n, 1)))).interval()
        inside += [ends[0, 0] <= 2.0 <= ends[0, 1], ends[1, 0] <= 1.0 <= ends[1, 1]]
    assert np.all(np.abs(inside / 200 - 0.9) < 3 * np.sqrt(0.09 / 200))


def test_parts_with_proportional_columns_are_one():
    g = np.random.default_rng(0)
    one = RandomPart("a", "wafer", g.normal(size=(20, 2, 1)))
    twice = RandomPart("b", "wafer", 2.0 * one.columns)
    lot_level = RandomPart("c", "lot", one.columns)
    found = merged([one, twice, lot_level])
    assert [part.name for part in found] == ["a", "c"]
    assert dict(found[0].members) == pytest.approx({"a": 0.2, "b": 0.8})
    assert found[0].columns == pytest.approx(np.sqrt(5.0) * one.columns)


def test_missing_values_are_left_out():
    g = np.random.default_rng(1)
    y = g.normal(size=(24, 2))
    lots = ["a"] * 12 + ["b"] * 12
    lot = plain_lot(y, lots, ["w"] * 24)
    n = 24
    each = [np.eye(2)[None, :, k : k + 1].repeat(n, 0) for k in (0, 1)]
    parts = tuple(RandomPart(f"{level}{k}", level, each[k]) for level in ("lot", "device") for k in (0, 1))
    model = LotModel((means(n, 2),), parts, np.zeros((n, 2)))
    object.__setattr__(
        lot, "values", np.where(np.arange(2) == 1, np.where(np.arange(n)[:, None] % 3 == 0, np.nan, y), y)
    )
    both = fitted(lot, model)
    keep = np.arange(n) % 3 != 0
    alone = plain_lot(y[keep, 1:], [lots[k] for k in np.flatnonzero(keep)], ["w"] * int(keep.sum()))
    ones = np.ones((int(keep.sum()), 1, 1))
    own = tuple(RandomPart(level, level, ones) for level in ("lot", "device"))
    single = fitted(alone, LotModel((means(len(ones), 1),), own, np.zeros((len(ones), 1))))
    assert both.variances[[1, 3]] == pytest.approx(single.variances, rel=1e-3, abs=1e-6)


def test_whole_wafers_are_held_out():
    lot = hold_out(plain_lot(np.arange(80.0), [str(k // 16) for k in range(80)], [str(k // 4 % 4) for k in range(80)]))
    assert len(lot.held) == 4
    assert int(lot.is_held.sum()) == 16
    many = hold_out(plain_lot(np.arange(64.0), [str(k // 8) for k in range(64)], [str(k // 4 % 2) for k in range(64)]))
    assert {name.split("/")[0] for name in many.held} == {"6", "7"}


def test_a_mean_that_nothing_determines_is_refused():
    lot = plain_lot(np.arange(48.0).reshape(24, 2) ** 0.5, ["a"] * 24, ["w"] * 24)
    object.__setattr__(lot, "values", np.where(np.arange(2) == 1, np.nan, lot.values))
    parts = (RandomPart("device", "device", np.eye(2)[None].repeat(24, 0)),)
    with pytest.raises(MeasurementError, match="does not determine the means"):
        fitted(lot, LotModel((means(24, 2),), parts, np.zeros((24, 2))))


def test_too_few_devices_are_refused():
    with pytest.raises(MeasurementError, match="too few devices"):
        plain_lot(np.arange(3.0), ["a"] * 3, ["w"] * 3)
