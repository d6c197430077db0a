"""The benchmarks of tests/bench run, and their table, limits and guard are right; no time is asserted."""

import json
import re
from pathlib import Path

import pytest
from bench.__main__ import RATIOS, main, measured, with_table
from bench.guard import FACTOR, Spread, Stored, read_stored, slower, spreads, write_stored
from bench.table import rest_of, results_of, table_of

BENCH = Path(__file__).parent / "bench"


def entry(name, role, least, **info):
    return {"extra_info": {"name": name, "role": role, **info}, "stats": {"min": least}}


def part(name, least, limit, inside="device", devices=1):
    return entry(name, "part", least, limit=limit, formula="f", inside=inside, devices=devices, ratio=least / 1e-3)


@pytest.fixture
def results():
    """A device of 10 ms with two parts of 4 and 3 ms, the first of which contains a third; 1 ns a flop, 10 ns a normal."""
    return results_of(
        [
            entry("flop", "primitive", 1e-3, count=1e6),
            entry("normal", "primitive", 1e-3, count=1e5),
            part("first", 4e-3, {"flop": 1e6, "normal": 1e5}),
            part("inner", 1e-3, {"flop": 5e5}, inside="first"),
            part("second", 24e-3, {"flop": 2e6}, devices=8),
            part("device", 80e-3, {}, inside="", devices=8),
            entry("slow peer", "peer", 0.02, of="second", times=200.0, note="10 of 2000 steps"),
        ]
    )


def test_limits_are_sums_of_counts_times_units(results):
    limits = {one.name: one.limit_s for one in results.parts}
    assert limits == pytest.approx({"first": 2e-3, "inner": 5e-4, "second": 2e-3, "device": 4e-3})
    assert rest_of(results) == pytest.approx(10e-3 - 4e-3 - 3e-3)


def test_ratios_are_per_device_and_peers_are_scaled_to_the_whole_task(results):
    second = next(one for one in results.parts if one.name == "second")
    assert second.ratio == pytest.approx(3.0)
    assert second.peers[0].seconds == pytest.approx(4.0)
    table = table_of(results)
    assert "| second | 3 | 3 | 2 | 1.5 | f |" in table
    assert "| second | slow peer | 4e+03 | 1.33e+03 | 10 of 2000 steps |" in table
    assert "inner, in first" in table


def test_a_limit_of_an_unknown_primitive_is_an_error():
    with pytest.raises(ValueError, match="not measured: \\['byte'\\]"):
        results_of([part("first", 1.0, {"byte": 1.0})])


def test_the_guard_reports_a_part_beyond_its_factor_and_no_other(results, tmp_path):
    before = {one.name: Spread(one.ratio, one.ratio, one.ratio, 1) for one in results.parts}
    assert slower(results, Stored("x", before)) == {}
    before["first"] = Spread(1.0, 4.0 / FACTOR * 1.01, 9.0, 5)
    before["second"] = Spread(1.0, 3.0 / FACTOR * 0.99, 9.0, 5)
    write_stored(tmp_path / "parts.json", Stored("x", before))
    (name,) = slower(results, read_stored(tmp_path / "parts.json"))
    assert name == "second"


def test_spreads_are_over_runs(results):
    double = results_of([part("first", 8e-3, {})])
    assert spreads([results, double, results])["first"] == Spread(4.0, 4.0, 8.0, 3)


def test_tables_of_the_page_are_replaced_and_a_page_without_a_place_is_refused():
    page = "a\n<!-- x -->\nold\n<!-- end of x -->\nb\n"
    assert with_table(page, "x", "new\n") == "a\n<!-- x -->\nnew\n<!-- end of x -->\nb\n"
    with pytest.raises(ValueError, match="no lines"):
        with_table(page, "y", "new\n")


def test_cheap_parts_run_beside_their_peers(capfd):
    found = {one.name: one for one in measured("part_noise or bandpass or sosfilt", seconds=0.01).parts}
    assert set(found) == {"noise and ADC", "bandpass"}
    assert all(one.ratio > 0.0 and one.limit_s > 0.0 for one in found.values())
    capfd.readouterr()


def test_every_part_has_a_stored_ratio():
    named = set()
    for path in BENCH.glob("bench_*.py"):
        text = path.read_text(encoding="utf-8")
        named |= {
            name for line in re.findall(r"^[A-Z, ]+ = (\"[^=]*\")$", text, re.M) for name in json.loads(f"[{line}]")
        }
    assert set(read_stored(RATIOS).parts) == named


def test_a_failed_benchmark_is_no_answer(monkeypatch):
    monkeypatch.setattr("bench.__main__.ROOT", Path(__file__).parent / "missing")
    with pytest.raises((RuntimeError, OSError)):
        main(["-k", "bandpass"])
