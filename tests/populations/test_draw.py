"""Random streams, null values, user irregularities, and the marginals of the default population.

Published: the percentiles at the end of section 8 of the project's collected facts, from an earlier Monte Carlo
of 48,480 dies.  They do not name the stage.  They are compared with the dies as fabricated, because the spreads listed there
would give wider percentiles after packaging (lower Q, 5 %: 1050 instead of 1354).
"""

from __future__ import annotations

import importlib
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.errors import UsageError
from pipeline.quantities import MODEL
from populations.draw import Draw, draw
from populations.irregularity import find
from populations.spec import PopulationSpec, load_spec

SPEC = load_spec()
DEVICES = 12_120  # twelve batches of 1010: 60 lots, 120 wafers


@lru_cache(maxsize=1)
def many() -> Draw:
    return draw(SPEC, 11, 0, DEVICES)


def arrays(drawn: Draw) -> dict[str, FloatArray]:
    """All numbers of a draw by name, without the causes of single irregularities."""
    named = {"index": drawn.index, "x": drawn.die_x_mm, "y": drawn.die_y_mm}
    named |= {f"fab.{name}": value for name, value in drawn.fab.items()}
    named |= {f"true.{name}": value for name, value in drawn.true.items()}
    named |= {f"{e}.{p}": value for e, values in drawn.effects.items() for p, value in values.items()}
    return named  # type: ignore[return-value]


def same(a: Draw, b: Draw) -> bool:
    first, second = arrays(a), arrays(b)
    return first.keys() == second.keys() and all(first[k].tobytes() == second[k].tobytes() for k in first)


def only(name: str, values: dict[str, float] | None = None) -> PopulationSpec:
    values = SPEC.irregularity[name] if values is None else values
    return msgspec.structs.replace(SPEC, irregularity={name: values})


def lower_quality(values: dict[str, FloatArray]) -> FloatArray:
    return np.asarray(1.0 / (2.0 * np.maximum(values["zeta1"], values["zeta2"])))


def quadrature_dps(values: dict[str, FloatArray]) -> FloatArray:
    double = np.deg2rad(2.0 * values["theta_deg"])
    rate = 2.0 * np.pi * values["split_hz"] * np.abs(np.sin(double)) / (2.0 * SPEC.angular_gain)
    return np.asarray(np.rad2deg(rate))


def axis_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.abs((a - b + 90.0) % 180.0 - 90.0))


def test_device_depends_on_seed_and_number_only_to_the_bit() -> None:
    block = draw(SPEC, 3, 0, 1000)
    for n in (0, 1, 7, 8, 15, 499, 998, 999):
        single = draw(SPEC, 3, n, 1)
        for name, values in arrays(block).items():
            assert values[n : n + 1].tobytes() == arrays(single)[name].tobytes(), (n, name)
        assert (single.device_id[0], single.wafer[0]) == (block.device_id[n], block.wafer[n])
    for first, count in ((10, 3), (200, 17), (777, 223)):
        part = draw(SPEC, 3, first, count)
        for name, values in arrays(block).items():
            assert values[first : first + count].tobytes() == arrays(part)[name].tobytes(), (first, name)
        for name, values in block.causes.items():
            assert values[first : first + count].tobytes() == part.causes[name].tobytes(), (first, name)
    assert not np.any(draw(SPEC, 4, 0, 50).true["split_hz"] == block.true["split_hz"][:50])


def test_names_follow_the_hierarchy() -> None:
    drawn = draw(SPEC, 0, 1008, 4)
    assert drawn.device_id == ("D001008", "D001009", "D001010", "D001011")
    assert drawn.wafer == ("L04-W02", "L05-W02", "L06-W01", "L07-W01")
    assert drawn.lot == ("L04", "L05", "L06", "L07")
    assert tuple(drawn.true) == tuple(drawn.fab) == tuple(quantity.name for quantity in MODEL)
    assert all(value.shape == (4,) and value.flags.c_contiguous for value in arrays(drawn).values())


@pytest.mark.parametrize("name", sorted(find()))
def test_irregularity_at_null_or_absent_changes_nothing_to_the_bit(name: str) -> None:
    irregularity = find()[name]
    null = {p.name: SPEC.irregularity[name][p.name] if p.null is None else p.null for p in irregularity.parameters}
    absent = {key: values for key, values in SPEC.irregularity.items() if key != name}
    without = draw(msgspec.structs.replace(SPEC, irregularity=absent), 5, 30, 300)
    at_null = draw(msgspec.structs.replace(SPEC, irregularity={**absent, name: null}), 5, 30, 300)
    assert same(without, at_null)
    assert not same(without, draw(SPEC, 5, 30, 300)), "the default values must have an effect"


@pytest.mark.parametrize("name", sorted(find()))
def test_irregularity_declares_units_ranges_meanings_source_and_acts_at_its_stage(name: str) -> None:
    irregularity = find()[name]
    assert irregularity.source
    for parameter in irregularity.parameters:
        assert parameter.unit
        assert parameter.meaning
        assert parameter.low < parameter.high
        assert parameter.null is None or parameter.low <= parameter.null <= parameter.high
    bare, drawn = draw(msgspec.structs.replace(SPEC, irregularity={}), 5, 0, 300), draw(only(name), 5, 0, 300)
    fab = any(not np.array_equal(bare.fab[q], drawn.fab[q]) for q in bare.fab)
    true = any(not np.array_equal(bare.true[q], drawn.true[q]) for q in bare.true)
    assert (fab, true) == {"fabrication": (True, True), "probe": (True, False), "package": (False, True)}[
        irregularity.stage
    ]


def test_new_irregularity_in_a_folder_changes_no_other_draw(tmp_path: Path) -> None:
    # The code block of the documentation, as it stands there.
    document = (Path(__file__).parents[2] / "docs" / "how-to" / "add-an-irregularity.md").read_text(encoding="utf-8")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "leaf_mass.py").write_text(document.split("```python\n")[1].split("```")[0], encoding="utf-8")
    table = "[irregularity.leaf_mass]\ndie_pct = {}\n"
    text = 'irregularity_folders = ["mine"]\n' + load_spec().to_toml().replace("irregularity_folders = []\n", "")
    file = tmp_path / "population.toml"
    file.write_text(text + table.format(0.0), encoding="utf-8")
    assert same(draw(load_spec(file), 9, 0, 30), draw(SPEC, 9, 0, 30))
    file.write_text(text + table.format(0.5), encoding="utf-8")
    mine, plain = draw(load_spec(file), 9, 0, 30), draw(SPEC, 9, 0, 30)
    assert not np.any(mine.true["split_hz"] == plain.true["split_hz"])
    assert mine.true["f3_hz"].tobytes() == plain.true["f3_hz"].tobytes()
    assert mine.true["zeta3"].tobytes() == plain.true["zeta3"].tobytes()
    assert "split_hz.leaf_mass" in mine.causes


def test_damping_is_positive_semidefinite_and_modes_are_ordered() -> None:
    wild = SPEC.with_values({"damping_anisotropy": 2.0, "residual_anisotropy": 1.0, "package_stress": 5.0})
    for drawn in (many(), draw(wild, 1, 0, 500)):
        for values in (drawn.fab, drawn.true):
            c11 = 4.0 * np.pi * values["f1_hz"] * values["zeta1"]
            c22 = 4.0 * np.pi * values["f2_hz"] * values["zeta2"]
            assert np.all(np.abs(values["c12_per_s"]) <= np.sqrt(c11 * c22))
            assert np.all(values["split_hz"] >= 0.0)
            assert np.all((values["theta_deg"] > -90.0) & (values["theta_deg"] <= 90.0))


def test_default_marginals_are_those_of_the_published_table() -> None:
    """5, 50 and 95 % points as fabricated; tolerance 4 standard errors.

    Die-level quantities: 12,120 nearly independent dies, plus lot and wafer shares over 60 lots and 120 wafers.
    """
    drawn = many()
    mean_hz = (drawn.fab["f1_hz"] + drawn.fab["f2_hz"]) / 2.0
    # (values, published points, standard error of each point: block bootstrap over lots, relative)
    table = [
        (drawn.fab["split_hz"], (0.53, 1.97, 4.09)),
        (lower_quality(drawn.fab), (1354.0, 1880.0, 2558.0)),
        (quadrature_dps(drawn.fab), (26.0, 277.0, 809.0)),
        (mean_hz, (526.0, 536.0, 545.0)),
    ]
    lots = np.array(drawn.lot)
    names, rng = np.unique(lots), np.random.default_rng(0)
    members = [np.flatnonzero(lots == name) for name in names]
    for values, published in table:
        boot = [
            np.percentile(
                values[np.concatenate([members[k] for k in rng.integers(0, len(names), len(names))])], [5, 50, 95]
            )
            for _ in range(100)
        ]
        # The published table is itself a sample, of some four times as many dies, and rounded.
        error = np.sqrt(1.25) * np.std(boot, axis=0) + 0.5 * np.array([10.0 ** -_decimals(p) for p in published])
        deviation = np.abs(np.percentile(values, [5, 50, 95]) - published) / error
        assert np.all(deviation < 4.0), deviation


def _decimals(value: float) -> int:
    return 0 if value == int(value) else len(f"{value}".split(".")[1])


def test_packaging_changes_theta_by_six_degrees_in_the_median() -> None:
    change = axis_distance(many().true["theta_deg"], many().fab["theta_deg"])
    # The density of the change near its median is about 0.06 / deg: standard error 0.5 / (0.06 sqrt(n)) = 0.08 deg.
    assert np.median(change) == pytest.approx(5.9, abs=4 * 0.08)


def test_the_paper_s_device_lies_within_the_default_population() -> None:
    true = many().true
    for name, paper in (
        ("f1_hz", 534.5),
        ("f2_hz", 536.4),
        ("f3_hz", 590.3),
        ("split_hz", 1.95),
        ("zeta1", 3.167e-4),
        ("zeta2", 1.586e-4),
        ("zeta3", 11.70e-4),
        ("rocking_gain", 13.2),
        ("updown_gain", 28.6),
    ):
        low, high = np.percentile(true[name], [2.5, 97.5])
        assert low < paper < high, name


def test_three_percent_of_lids_leak_and_their_q_is_a_quarter_or_less() -> None:
    leaking = many().causes["ln_quality.lid_leak"] < 0.0
    expected = 0.03 * DEVICES
    # A rise of exp(N(2.5, 0.8)) is below 1, hence none, for 0.09 % of leakers.
    assert abs(leaking.sum() - expected) < 4.0 * np.sqrt(expected)
    quality = lower_quality(many().true)
    assert np.median(quality[leaking]) < 0.25 * np.median(quality[~leaking])


def test_thickness_has_the_declared_variance_components() -> None:
    """Nested one-way estimates of lot, wafer and residual variance of ln f, each within 4 standard errors."""
    values = {"lot_pct": 0.5, "wafer_pct": 0.4, "die_pct": 0.3}
    drawn = draw(only("spring_thickness", values), 2, 0, DEVICES)
    ln_t = (100.0 * np.log(drawn.true["f1_hz"]) / 1.5).reshape(12, 101, 2, 5)  # batch, die, wafer, lot
    within = ln_t.var(axis=1, ddof=1).mean()
    means = ln_t.mean(axis=1)
    wafer = means.var(axis=1, ddof=1).mean() - within / 101
    lot = means.mean(axis=1).ravel().var(ddof=1) - wafer / 2.0 - within / 202
    assert within == pytest.approx(0.3**2, rel=4 * np.sqrt(2 / 12_000))
    assert wafer == pytest.approx(0.4**2, rel=4 * np.sqrt(2 / 60))
    assert lot == pytest.approx(0.5**2, abs=4 * np.sqrt(2 / 59) * (0.5**2 + 0.4**2 / 2))


def test_bow_varies_with_the_radius_and_the_field_is_correlated_over_the_declared_length() -> None:
    bow = draw(only("spring_thickness", {"bow_pct": 0.6}), 0, 0, 101)
    rho2 = (bow.die_x_mm**2 + bow.die_y_mm**2) / 50.0**2
    expected = 535.5 * (1.0 + 0.006 * (rho2 - 0.5)) ** 1.5
    # A spring sits at 2 mm from the centre: 1e-5 of thickness.
    np.testing.assert_allclose(bow.true["f1_hz"], expected, rtol=2e-5)
    assert np.all(bow.true["split_hz"] < 535.5 * 1e-4), "a smooth bow causes almost no split"
    field = draw(only("spring_thickness", {"field_pct": 1.0, "field_length_mm": 15.0}), 0, 0, DEVICES)
    ln_t = 100.0 * np.log(field.true["f1_hz"] / 535.5) / 1.5
    by_wafer = {}
    for value, name, x, y in zip(ln_t, field.wafer, field.die_x_mm, field.die_y_mm):
        by_wafer[name, x, y] = value
    pairs = [(v, by_wafer[n, 8.0, 0.0]) for (n, x, y), v in by_wafer.items() if (x, y) == (0.0, 0.0)]
    measured = np.mean([a * b for a, b in pairs])
    assert measured == pytest.approx(np.exp(-8.0 / 15.0), abs=4 * np.sqrt((1 + np.exp(-16 / 15)) / len(pairs)))


def test_residual_anisotropy_has_no_preferred_axis_and_rayleigh_splits() -> None:
    drawn = draw(only("residual_anisotropy", {"die_pct": 0.3}), 0, 0, 4000)
    split, theta = drawn.true["split_hz"], np.deg2rad(drawn.true["theta_deg"])
    sigma = 535.5 * 0.003
    assert np.mean(split**2) == pytest.approx(2 * sigma**2, rel=4 / np.sqrt(4000))
    for order in (2, 4):
        assert abs(np.mean(np.exp(1j * order * theta))) < 4 / np.sqrt(4000)


def test_rotation_of_the_crystal_causes_no_split_of_four_equal_springs() -> None:
    misoriented = draw(only("misorientation", {"lot_deg": 5.0}), 0, 0, 50)
    assert np.all(misoriented.true["split_hz"] < 1e-9)
    assert np.ptp(misoriented.true["f1_hz"]) > 0.1


def test_causes_add_up_to_the_split_to_first_order() -> None:
    drawn = many()
    total = sum(value for name, value in drawn.causes.items() if name.startswith("split_hz."))
    # Second order: products of relative changes of a few percent with the split.
    np.testing.assert_allclose(total, drawn.true["split_hz"], rtol=0.06, atol=2e-3)


def test_varying_an_assumption_scales_its_quantity_and_keeps_the_random_numbers() -> None:
    base = draw(only("residual_anisotropy"), 1, 0, 100).true
    swept = draw(only("residual_anisotropy").with_values({"residual_anisotropy": 0.56}), 1, 0, 100).true
    np.testing.assert_allclose(swept["split_hz"], 2.0 * base["split_hz"], rtol=1e-3)
    np.testing.assert_allclose(swept["theta_deg"], base["theta_deg"], atol=1e-9)
    stiff = draw(SPEC.with_values({"package_stress": 1.23}), 1, 0, 400)
    soft = draw(SPEC, 1, 0, 400)
    assert np.median(axis_distance(stiff.true["theta_deg"], stiff.fab["theta_deg"])) > 3 * np.median(
        axis_distance(soft.true["theta_deg"], soft.fab["theta_deg"])
    )


@pytest.mark.parametrize("arguments", [(-1, 0, 1), (0, -1, 1), (0, 0, 0)])
def test_negative_seed_or_first_device_and_zero_devices_are_usage_errors(arguments: tuple[int, int, int]) -> None:
    with pytest.raises(UsageError, match="too small"):
        draw(SPEC, *arguments)


def test_effects_of_a_draw_are_parameters_of_the_effect_library_within_their_ranges() -> None:
    for name, values in many().effects.items():
        effect = importlib.import_module(f"pipeline.device.effects.{name}").EFFECT
        declared = {parameter.name: parameter for parameter in effect.parameters}
        assert set(values) == set(declared)
        for parameter, drawn in values.items():
            assert np.all((declared[parameter].low <= drawn) & (drawn <= declared[parameter].high))
