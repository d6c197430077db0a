"""P(conform) at each common error: the compiled count against the computation of every quantity at every node."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.device.gyro import PHYSICAL
from pipeline.experiment.systematic import Systematic
from pipeline.inference.estimate import RateSettings, identified_quantities
from pipeline.inference.systematic import Identified, common_factors, common_nodes
from pipeline.quantities import IDENTIFIED
from reports.limits import load_limits
from reports.what_if.draws import DrawBatch
from workflows.what_if import common
from workflows.what_if.counted import counts

RATE = RateSettings(0.7, 1.0, "f2", Systematic(0.5, 0.007, 0.01, 50.0, 2.0))
CENTRE = {
    "f1_hz": 534.5, "f2_hz": 536.3, "f3_hz": 915.0, "zeta1": 3.2e-4, "zeta2": 3.1e-4, "zeta3": 4e-4, "theta_deg": 80.0,
    "c12_per_s": 0.03, "rocking_gain": 900.0, "updown_gain": 700.0, "sense_imbalance": 0.01, "drive_imbalance": -0.01,
}  # fmt: skip
OLD = load_limits({"limits": {"split_hz": {"max": 2.0}, "f1_hz": {"min": 534.0, "max": 535.0}}})
NEW = {
    "split_hz": {"min": 1.5, "max": 2.1},
    "f3_hz": {"max": 915.5},
    "quality1": {"min": 1500.0},
    "zeta2": {"max": 3.13e-4},
    "rocking_gain": {"max": 912.0},
    "theta_deg": {"min": 70.0, "max": 95.0},
    "c12_per_s": {"max": 0.05},
    "quadrature_bias_dps": {"max": 3.0},
    "inphase_bias_dps": {"min": 0.5},
    "rate_bias_dps": {"min": -6.0, "max": 6.0},
    "sense_imbalance": {"max": 0.011},
}


@pytest.fixture(scope="module")
def measured():
    random = np.random.default_rng(4)
    spread = {"theta_deg": 8.0, "f1_hz": 0.3, "f2_hz": 0.3, "f3_hz": 0.5, "c12_per_s": 0.02, "sense_imbalance": 0.001}
    physical = np.stack(
        [CENTRE[q] + spread.get(q, 0.02 * abs(CENTRE[q])) * random.normal(size=(6, 40)) for q in PHYSICAL], axis=-1
    )
    return Identified(physical, physical[..., 1] - physical[..., 0], RATE)


def test_the_factors_give_every_identified_quantity_at_every_node(measured):
    z = common_nodes(50)
    base = identified_quantities(measured.physical, measured.rate, measured.split_hz)
    factors = common_factors(RATE, z)
    unmoved = {"theta_deg", "sense_imbalance", "drive_imbalance"}
    assert factors.keys() == {quantity.name for quantity in IDENTIFIED} - unmoved
    for k in (0, 17, 49):
        found = measured.given(np.broadcast_to(z[k], (6, 40, 5)))
        for name, terms in factors.items():
            own = sum(base[u] * a[k] for u, a in terms)
            np.testing.assert_allclose(own, found[name], rtol=1e-12, atol=1e-12, err_msg=name)
        for name in unmoved:
            np.testing.assert_array_equal(base[name], found[name])


def test_biases_need_an_angular_gain():
    assert "rate_bias_dps" not in common_factors(replace(RATE, angular_gain=None), common_nodes(5))


def new_limits(**more):
    return load_limits({"limits": NEW | more})


def both_ways(measured, normal, p_run, new):
    names = tuple(dict.fromkeys((*OLD.quantities, *new.quantities)))
    nodes = common_nodes(len(p_run))
    batch = DrawBatch(np.arange(6), normal)
    return (
        common._by_factors(names, measured, normal, nodes, p_run, OLD, new),
        common._by_figures(batch, names, measured, nodes, p_run, OLD, new),
    )


@pytest.mark.parametrize("limits", [NEW, *({name: one} for name, one in NEW.items())], ids=["all", *NEW])
def test_both_ways_give_the_same_probabilities(limits, measured):
    p_run = np.random.default_rng(5).uniform(size=(30, 6))
    p_run[3] = np.nan
    p_run[:, 2] = 1.0
    fast, slow = both_ways(measured, {}, p_run, load_limits({"limits": limits}))
    np.testing.assert_allclose(fast, slow, atol=1e-14)
    assert 0.0 < fast.mean() < 1.0


def test_normal_draws_and_unknown_ones(measured):
    p_run = np.full((20, 6), 0.6)
    spread = {"shock_limit_g": 100.0 + np.arange(240.0).reshape(6, 40)}
    new = new_limits(shock_limit_g={"min": 150.0})
    fast, slow = both_ways(measured, spread, p_run, new)
    np.testing.assert_allclose(fast, slow, atol=1e-14)
    # Draws that are nan have no count: the bounds of P are found by the other way.
    spread["shock_limit_g"][1, 3] = np.nan
    assert both_ways(measured, spread, p_run, new)[0] is None
    # A figure is no multiple of what was measured.
    assert both_ways(measured, {}, p_run, new_limits(bandwidth_hz={"min": 1.0}))[0] is None


def test_the_counts_are_those_of_the_definition():
    random = np.random.default_rng(6)
    values = {"f1_hz": random.uniform(size=(3, 20)), "f2_hz": random.uniform(size=(3, 20))}
    a, b = random.uniform(0.5, 1.5, size=(2, 4))
    old = load_limits({"limits": {"f1_hz": {"max": 0.5}}})
    new = load_limits({"limits": {"f1_hz": {"min": 0.2}, "f2_hz": {"max": 0.9}}})
    found = counts(values, {"f1_hz": (("f1_hz", a), ("f2_hz", b))}, old, new)
    for k in range(4):
        moved = a[k] * values["f1_hz"] + b[k] * values["f2_hz"]
        met_old, met_new = moved <= 0.5, (moved >= 0.2) & (values["f2_hz"] <= 0.9)
        assert found.old[k].tolist() == met_old.sum(axis=1).tolist()
        assert found.new[k].tolist() == met_new.sum(axis=1).tolist()
        assert found.both[k].tolist() == (met_old & met_new).sum(axis=1).tolist()
