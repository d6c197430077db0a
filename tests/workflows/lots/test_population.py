"""A population at the devices of a lot: candidates, merged parts, and the refined file."""

import msgspec
import numpy as np
import pytest

from pipeline.errors import ConfigError
from pipeline.learning.lot.gyro import COORDINATES, UNITS, coordinates
from pipeline.learning.lot.measured import MeasuredLot
from pipeline.learning.lot.prepared import free
from populations.draw import draw
from populations.spec import PopulationSpec, load_spec
from workflows.lots.population import population_at, refined_spec
from workflows.lots.simulate import with_irregularities

SPEC = load_spec(None)


def without(*names: str) -> PopulationSpec:
    tables = {name: values for name, values in SPEC.irregularity.items() if name not in names}
    return msgspec.structs.replace(SPEC, irregularity=tables)


@pytest.fixture(scope="module")
def lot() -> MeasuredLot:
    made = draw(SPEC, 1, 0, 60)
    n = len(made.index)
    return MeasuredLot(
        "lot", COORDINATES, UNITS, coordinates(made.true), np.zeros((n, 12, 12)), {"lot": made.lot, "wafer": made.wafer},
        made.die_x_mm, made.die_y_mm, 50.0, np.full(n, np.nan), made.device_id,
    )  # fmt: skip


def test_what_the_file_lacks_is_a_candidate(lot):
    names = {part.name for part in population_at(without("electrode_gap", "sidewall_tilt"), lot).candidates}
    assert {"electrode_gap.lot", "electrode_gap.wafer", "electrode_gap.die", "sidewall_tilt.pattern"} <= names
    assert not any(name.startswith("residual_anisotropy") for name in names)
    # Held at null in the shipped file.
    assert "spring_width.wedge" in names
    (leak,) = population_at(without("lid_leak"), lot).absent_mixtures
    assert leak.name == "lid_leak"


def test_thickness_and_width_are_one_part(lot):
    model = free(population_at(SPEC, lot).model)
    members = {part.name: {name for name, _ in part.members} for part in model.random}
    assert members["spring_thickness.lot"] == {"spring_thickness.lot", "spring_width.lot"}
    assert "spring_width.lot" not in members
    assert [part.name for part in model.fixed] == ["mean", "sidewall_tilt.pattern", "spring_thickness.pattern"]
    assert model.fixed[2].members == ("spring_thickness.pattern", "spring_width.pattern")


def test_factors_become_parameters():
    factors = {"residual_anisotropy.lot": 2.0, "residual_anisotropy.wafer": 1.0, "residual_anisotropy.die": 1.0}
    own = refined_spec(SPEC, factors, []).irregularity["residual_anisotropy"]
    before = SPEC.irregularity["residual_anisotropy"]
    assert own["lot_ratio"] == pytest.approx(2.0 * before["lot_ratio"], rel=1e-2)
    assert own["die_pct"] == pytest.approx(before["die_pct"], rel=1e-2)
    assert own["wafer_ratio"] == pytest.approx(before["wafer_ratio"], rel=1e-2)
    tilt = refined_spec(SPEC, {"electrode_gap.wafer": 0.5}, []).irregularity["electrode_gap"]
    assert tilt == {**SPEC.irregularity["electrode_gap"], "wafer_pct": pytest.approx(0.15, rel=1e-2)}


def test_an_added_part_brings_what_it_needs():
    file = without("electrode_gap")
    own = refined_spec(file, {"electrode_gap.wafer": 3.0}, ["electrode_gap.wafer"]).irregularity["electrode_gap"]
    assert own["wafer_pct"] == pytest.approx(0.9, rel=1e-2)
    assert own.get("lot_pct", 0.0) == 0.0
    assert own.get("die_pct", 0.0) == 0.0


def test_a_factor_of_one_changes_nothing():
    factors = {"damping.lot": 1.0, "damping.die": 1.0, "spring_thickness.bow": 1.0, "spring_thickness.pattern": 1.0}
    refined = refined_spec(SPEC, factors, [])
    for name, values in SPEC.irregularity.items():
        assert refined.irregularity[name] == pytest.approx(values)


def test_irregularities_of_a_virtual_lot():
    spec, truth = with_irregularities(without("sidewall_tilt"), ["sidewall_tilt:edge_deg=1.1"])
    assert truth["sidewall_tilt"] == {"edge_deg": 1.1, "anisotropy_pct_per_deg2": 0.278}
    assert spec.irregularity["sidewall_tilt"] == truth["sidewall_tilt"]
    with pytest.raises(ConfigError, match="unknown parameter"):
        with_irregularities(SPEC, ["sidewall_tilt:edge=1"])
