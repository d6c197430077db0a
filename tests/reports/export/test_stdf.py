"""STDF files are what the specification says: an independent reader finds every device, value, limit and bin in them."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from stdf_reader import TABLES, fields, records

from pipeline.quantities import NAMES
from pipeline.store.schema import devices_table
from reports.devices import Devices
from reports.export import stdf_fields
from reports.export.dies import die_grid
from reports.export.stdf import NightIdentity, stdf_chunks, stdf_night
from reports.limits import Limits, load_limits

IDENTITY = NightIdentity("20261123T010203000-seed1", "2026-11-23T01:02:03+00:00", "2026-11-23T02:00:00+00:00", "0.1.0")
LIMITS = load_limits({"limits": {"split_hz": {"max": 3.0}, "f1_hz": {"min": 500.0, "max": 540.0}}})


def file_of(columns: dict, limits: Limits = LIMITS, lot: str = "L1") -> list:
    night = stdf_night(Devices(devices_table(columns)), limits, IDENTITY)
    return list(records(b"".join(stdf_chunks(night, lot))))


def parts_of(found: list) -> dict[str, dict]:
    """device -> its PRR fields, with the results by test number."""
    numbers, parts, tests = {}, {}, {}
    for name, values in found:
        if name == "PIR":
            tests = {}
        elif name == "PTR":
            tests[values["TEST_NUM"]] = values
            if "TEST_TXT" in values:
                numbers[values["TEST_NUM"]] = values
        elif name == "PRR":
            parts[values["PART_ID"]] = values | {
                "tests": {numbers[n]["TEST_TXT"]: one for n, one in tests.items()},
                "defaults": {one["TEST_TXT"]: one for one in numbers.values()},
            }
    return parts


def night(count: int = 40, wafers: int = 2) -> dict:
    random = np.random.default_rng(3)
    split = random.uniform(0.5, 4.0, count)
    verdict = np.where(split <= 3.0, "pass", "fail").tolist()
    status = ["ok"] * count
    verdict[5], status[6], verdict[6], split[7] = "undecided", "misfit", "undecided", np.nan
    return {
        "device_id": [f"D{k:03d}" for k in range(count)],
        "lot": ["L1" if k % 4 else "L2" for k in range(count)],
        "wafer": [f"W{k % wafers}" for k in range(count)],
        "die_x_mm": 8.0 * (np.arange(count) % 7) - 24.0,
        "die_y_mm": 6.0 * (np.arange(count) // 7) - 18.0,
        "split_hz": split,
        "split_hz_sd": np.full(count, 0.01),
        "f1_hz": random.uniform(520.0, 530.0, count),
        "theta_deg": random.uniform(-90.0, 90.0, count),
        "p_pass": np.where(split <= 3.0, 0.99, 0.01),
        "verdict": verdict,
        "failed_limits": ["" if one != "fail" else "split_hz" for one in verdict],
        "status": status,
        "status_reason": ["" if one == "ok" else "unexplained" for one in status],
    }


def test_every_device_value_and_place_is_read_back_and_counted():
    columns = night()
    found = file_of(columns)
    parts = parts_of(found)
    chosen = [k for k, lot in enumerate(columns["lot"]) if lot == "L1"]
    assert set(parts) == {columns["device_id"][k] for k in chosen}
    for k in chosen:
        part = parts[columns["device_id"][k]]
        for quantity in ("split_hz", "f1_hz", "theta_deg", "p_pass"):
            value, one = columns[quantity][k], part["tests"][quantity]
            if math.isnan(value):
                assert one["TEST_FLG"] & 0x42 == 0x42
            else:
                assert one["RESULT"] == np.float32(value)
                assert not one["TEST_FLG"] & 0x02
        assert (part["X_COORD"], part["Y_COORD"]) == (k % 7 - 3, k // 7 - 3)
        assert part["NUM_TEST"] == len(part["tests"])
    kinds = [name for name, _ in found]
    assert kinds[:3] == ["FAR", "MIR", "WCR"]
    assert kinds[-2:] == ["PCR", "MRR"]
    last = dict(found)
    assert last["PCR"]["PART_CNT"] == len(chosen)
    assert last["PCR"]["GOOD_CNT"] == sum(columns["verdict"][k] == "pass" for k in chosen)
    assert last["MIR"]["LOT_ID"] == "L1"
    assert last["MIR"]["SETUP_T"] == 1795395723
    assert (last["WCR"]["DIE_WID"], last["WCR"]["DIE_HT"], last["WCR"]["WF_UNITS"]) == (8.0, 6.0, 3)


def test_wafers_enclose_their_parts_and_count_them():
    wafer, inside, counted = None, Counter(), {}
    for name, values in file_of(night()):
        if name == "WIR":
            wafer = values["WAFER_ID"]
        elif name == "PRR":
            assert wafer is not None
            inside[wafer] += 1
        elif name == "WRR":
            assert values["WAFER_ID"] == wafer
            counted[wafer], wafer = values["PART_CNT"], None
    assert counted == dict(inside)
    assert set(counted) == {"W0", "W1"}


def test_bins_and_flags_state_the_verdict_and_bin_records_add_up():
    columns = night()
    found = file_of(columns)
    parts = parts_of(found)
    expected = {"pass": (1, 1, 0x00), "fail": (2, 10, 0x08), "undecided": (3, 3, 0x10)}
    for k, name in enumerate(columns["device_id"]):
        if name in parts:
            one = parts[name]
            wanted = (4, 6, 0x14) if columns["status"][k] == "misfit" else expected[columns["verdict"][k]]
            assert (one["HARD_BIN"], one["SOFT_BIN"], one["PART_FLG"]) == wanted, name
            assert one.get("PART_TXT", "") == columns["status_reason"][k]
    for kind, field in (("HBR", "HARD"), ("SBR", "SOFT")):
        letter = kind[0]
        counts = {v[f"{letter}BIN_NUM"]: v[f"{letter}BIN_CNT"] for n, v in found if n == kind}
        seen = Counter(one[f"{field}_BIN"] for one in parts.values())
        assert {number: count for number, count in counts.items() if count} == dict(seen)
    names = {v["SBIN_NUM"]: (v["SBIN_NAM"], v["SBIN_PF"]) for n, v in found if n == "SBR"}
    assert names[10] == ("split_hz max 3", "F")


def test_limits_and_units_are_declared_once_and_flags_follow_from_them():
    columns = night()
    parts = parts_of(file_of(columns))
    defaults = next(iter(parts.values()))["defaults"]
    split, f1, theta = (defaults[name] for name in ("split_hz", "f1_hz", "theta_deg"))
    assert (split["UNITS"], f1["UNITS"], theta["UNITS"]) == ("Hz", "Hz", "deg")
    # Bit 1 is reserved and 1; no specification limits; bit 6: no low limit, bit 7: no high limit.
    assert (split["OPT_FLAG"], f1["OPT_FLAG"], theta["OPT_FLAG"]) == (0x4E, 0x0E, 0xCE)
    assert (split["HI_LIMIT"], f1["LO_LIMIT"], f1["HI_LIMIT"]) == (3.0, 500.0, 540.0)
    for k, name in enumerate(columns["device_id"]):
        if name not in parts:
            continue
        one, value, ok = parts[name]["tests"]["split_hz"], columns["split_hz"][k], columns["status"][k] == "ok"
        if math.isnan(value):
            continue
        assert bool(one["TEST_FLG"] & 0x80) == (value > 3.0)
        assert bool(one["PARM_FLG"] & 0x08) == (value > 3.0)
        assert bool(one["TEST_FLG"] & 0x04) == (not ok)
        assert parts[name]["tests"]["theta_deg"]["TEST_FLG"] & 0x40


def test_an_axis_lies_on_the_branch_of_its_arc_so_that_the_limits_judge_it():
    limits = load_limits({"limits": {"theta_deg": {"min": 80.0, "max": 100.0}}})
    columns = {"device_id": ["a", "b", "c"], "lot": ["L1"] * 3, "theta_deg": [85.0, -85.0, -70.0], "status": ["ok"] * 3}
    tests = [one["tests"]["theta_deg"] for one in parts_of(file_of(columns, limits)).values()]
    assert [one["RESULT"] for one in tests] == [85.0, 95.0, 110.0]
    assert [bool(one["TEST_FLG"] & 0x80) for one in tests] == [False, False, True]


def test_the_synopsis_gives_mean_and_spread():
    columns = night()
    found = file_of(columns)
    values = np.array([v["RESULT"] for n, v in found if n == "PTR" and v["TEST_NUM"] == 1000 + NAMES.index("f1_hz")])
    one = next(v for n, v in found if n == "TSR" and v["TEST_NAM"] == "f1_hz")
    assert one["EXEC_CNT"] == values.size
    assert one["TST_SUMS"] / values.size == pytest.approx(values.mean(), rel=1e-6)
    assert (one["TEST_MIN"], one["TEST_MAX"]) == (values.min(), values.max())
    nothing = next(v for n, v in file_of(columns | {"p_pass": None}) if n == "TSR" and v["TEST_NAM"] == "p_pass")
    assert nothing["OPT_FLAG"] == 0xFF


def test_devices_without_wafer_lot_or_place_are_exported_without_them():
    found = file_of({"device_id": ["a"], "split_hz": [1.0], "status": ["ok"], "verdict": ["pass"]}, lot="")
    kinds = Counter(name for name, _ in found)
    assert kinds["WIR"] == kinds["WRR"] == kinds["WCR"] == 0
    part = next(values for name, values in found if name == "PRR")
    assert (part["X_COORD"], part["Y_COORD"]) == (-32768, -32768)
    assert dict(found)["MIR"]["LOT_ID"] == IDENTITY.run_id


@given(st.text(alphabet=st.characters(codec="ascii", exclude_categories=("Cc",)), max_size=600))
def test_texts_come_back_and_longer_ones_are_cut_to_255_and_counted(name):
    data = stdf_fields.prr(0, 1, 1, 1, 0, 0, name, "")
    body, table = data[4:], TABLES[5, 20][1]
    assert fields(body, table, "<")["PART_ID"] == name[:255]
    columns = {"device_id": [name or "x"], "lot": ["L1"], "status": ["ok"]}
    assert stdf_night(Devices(devices_table(columns)), LIMITS, IDENTITY).cut_texts() == (len(name) > 255)


_NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(_NUMBERS, _NUMBERS), min_size=1, max_size=20))
def test_any_values_are_read_back_or_marked_invalid(values):
    columns = {
        "device_id": [f"D{k}" for k in range(len(values))],
        "lot": ["L1"] * len(values),
        "split_hz": [a for a, _ in values],
        "f1_hz": [b for _, b in values],
        "p_pass": [0.5] * len(values),
        "status": ["ok"] * len(values),
    }
    parts = parts_of(file_of(columns))
    largest = float(np.finfo(np.float32).max)
    for k, (split, f1) in enumerate(values):
        for quantity, value in (("split_hz", split), ("f1_hz", f1)):
            one = parts[f"D{k}"]["tests"].get(quantity)
            if one is None:  # no device has a finite value
                assert not any(math.isfinite(pair[quantity == "f1_hz"]) for pair in values)
            elif math.isfinite(value) and abs(value) <= largest:
                assert one["RESULT"] == np.float32(value)
                assert not one["TEST_FLG"] & 0x02
            else:
                assert one["TEST_FLG"] & 0x42 == 0x42


@given(
    st.floats(0.5, 20.0), st.floats(0.5, 20.0), st.floats(-0.5, 0.5),
    st.sets(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=3, max_size=60),
)  # fmt: skip
def test_the_grid_of_dies_is_found_from_their_positions(p_x, p_y, offset, places):
    x, y = (np.array(axis, dtype=float) for axis in zip(*sorted(places)))
    # Positions of files are rounded to a micrometre.
    found = die_grid(np.round(p_x * (x + offset), 3), np.round(p_y * (y + offset), 3))
    assert found.known.all()
    for place, true in ((found.x, x), (found.y, y)):
        steps, shown = np.diff(np.unique(true)), np.diff(np.unique(place))
        if steps.size:
            # Dies all an even number of places apart have twice the pitch.
            common = np.gcd.reduce(steps.astype(int))
            assert np.array_equal(shown * common, steps)


def test_positions_on_no_grid_have_no_places():
    random = np.random.default_rng(1)
    x, y = random.uniform(-50.0, 50.0, (2, 200))
    assert not die_grid(x, y).known.any()
