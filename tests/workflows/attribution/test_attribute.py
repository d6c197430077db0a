"""gyroscreen attribute: shares and what-if of stored devices, against new draws of the population, and wrong input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.store.columns import with_run
from pipeline.store.query import query
from pipeline.store.read import find_run
from populations.draw import draw
from populations.spec import load_spec
from populations.spreads import spread_numbers
from populations.stored import draw_stored, number_names
from reports.attribution.content import Attribution, OutputShares, Source, SourceShare
from reports.decision import conforms
from reports.devices import Devices
from reports.interval_estimate import IntervalEstimate
from reports.run.page import render_run_report
from reports.run.sources import loss_sources
from reports.words.attribution import attribution_lines
from tests.judged_runs import judged_config, judged_run
from workflows.attribution.night import attribution_of
from workflows.attribution.shares import process_shares
from workflows.attribution.stored import stored_numbers
from workflows.attribution.what_if import what_if
from workflows.cli import call
from workflows.config import RunConfig, load_config
from workflows.screening.block import true_quantities
from workflows.screening.settings import population

NARROW = "damping_anisotropy.die*0.5"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """1200 devices of sixty lots, judged by their true values."""
    folder = tmp_path_factory.mktemp("judged")
    judged_run(folder / "results", judged_config(folder, 1200))
    return folder / "results"


def changed(results: Path, change: str):
    folder = find_run(results)
    return with_run(
        results, None, lambda t: what_if(load_config(results.parent / "run.toml"), folder, t.devices, change)
    )


def loss_of_new_devices(config, spec, devices, seed):
    """Share of lost devices of an independent draw of a population, and its sd with lots as draws."""
    drawn = draw(spec, seed, 0, devices)
    lost = ~conforms(config.judged_by(), true_quantities(config, drawn.true, float(spec.angular_gain)))
    _, lot = np.unique(drawn.lot, return_inverse=True)
    sums = np.bincount(lot, weights=lost - lost.mean())
    return lost.mean(), np.sqrt(np.sum(sums**2)) / devices


def test_what_if_equals_a_new_run_of_the_changed_population(run):
    config = load_config(run.parent / "run.toml")
    spec = population(config).with_values({"damping_anisotropy.die": 0.11})
    new, sd = loss_of_new_devices(config, spec, 1800, 99)
    found = changed(run, NARROW)
    assert found.refusal == ""
    for after in (found.truth.after, found.reweighted["truth"].after, found.reweighted["verdict"].after):
        assert after.value == pytest.approx(new, abs=2.5 * np.hypot(after.sd, sd))
    # The change is much better known than either share, and it is not zero.
    assert found.truth.difference.high < 0.0
    assert found.truth.difference.sd < 0.7 * found.truth.after.sd
    assert found.reweighted["truth"].difference.high < 0.0


def test_devices_drawn_again_without_a_change_are_the_same(run):
    found = changed(run, "damping_anisotropy.die*1")
    assert found.truth.difference.value == 0.0
    columns = with_run(run, None, lambda t: Devices(t.devices).number("true_split_hz"))
    spec = population(load_config(run.parent / "run.toml"))
    drawn = draw(spec, 1, 0, 1200)
    again = draw_stored(spec, spec, drawn.index, drawn.numbers.values.T.astype(np.float32).astype(float), 1)
    # float32 of a standard normal: 1e-7 of each spread.
    np.testing.assert_allclose(again.true["split_hz"], columns, atol=1e-5)
    np.testing.assert_allclose(again.fab["f1_hz"], drawn.fab["f1_hz"], atol=1e-4)
    assert drawn.numbers.names == number_names(spec)


def test_shares_name_what_was_made_large(tmp_path):
    config = judged_config(tmp_path, 10, "values = { residual_anisotropy = 3.0 }\n[limits.split_hz]\nmax = 20.0\n")
    loss = process_shares(config, 300)[0]
    assert (loss.shares[0].source.irregularity, loss.shares[0].source.level) == ("residual_anisotropy", "die")
    assert loss.shares[0].share.value > 0.6
    assert sum(one.share.value for one in loss.shares) == pytest.approx(1.0)


def test_the_command_prints_shares_and_what_if(run, capfd):
    arguments = ["attribute", "--results", str(run), "--json"]
    assert call([*arguments, "--samples", "200"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert sum(one["share"]["value"] for one in found["process"][0]["shares"]) == pytest.approx(1.0)
    assert found["stored"]["lots"] == 60
    assert found["stored"]["outputs"][0]["rest"]["sd"] > 0.0
    assert found["verdicts"]["value"] == 1.0
    assert call([*arguments, "--what-if", NARROW]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["changes"] == {"damping_anisotropy.die": [0.22, 0.11]}
    assert call([*arguments[:-1], "--what-if", "spring_width.bow_um=0"]) == 0
    assert "not reweighted: spring_width.bow_um is no spread" in capfd.readouterr().out
    assert call([*arguments[:-1], "--what-if", "lid_pressure.spread*2"]) == 0
    assert "not reweighted: lid_pressure.spread: only spreads that become smaller" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--what-if", "spring_width.wafer"], "--what-if does not state a change"),
        (["--what-if", "spring_width.wafer_um*nan"], "--what-if does not state a change"),
        (["--what-if", "spring_width.wafer_um*1e999"], "--what-if does not state a change"),
        (["--what-if", "spring_widht.wafer_um*0.5"], "did you mean spring_width.wafer_um"),
        (["--what-if", "spring_width.wafer_um=-1"], "out of range"),
        (["--what-if", "spring_width.field_length_mm=5"], "not stored with this correlation length"),
        (["--samples", "1"], "too few --samples"),
        (["nosuchrun"], "there is no such run"),
    ],
)
def test_wrong_input_is_one_message(run, capfd, options, message):
    assert call(["attribute", "--results", str(run), *options]) == 2
    shown = capfd.readouterr().err
    assert message in shown
    assert "Traceback" not in shown
    assert shown.count("\n") == 1


def test_a_run_without_stored_irregularities_has_shares_and_no_what_if(tmp_path, capfd):
    judged_run(tmp_path / "results", judged_config(tmp_path, 60), stored=False)
    assert call(["attribute", "--results", str(tmp_path / "results"), "--samples", "50"]) == 0
    assert "stored no irregularities" in capfd.readouterr().out
    assert call(["attribute", "--results", str(tmp_path / "results"), "--what-if", NARROW]) == 2
    assert "stored no irregularities" in capfd.readouterr().err


def test_a_run_of_campaigns_or_without_devices_is_refused(tmp_path, capfd):
    from pipeline.store.run import create_run

    create_run(tmp_path, "measured", '[source]\nkind = "campaigns"\npath = "."\n', {}).finish("complete", {})
    assert call(["attribute", "--results", str(tmp_path)]) == 2
    assert "the run has no devices" in capfd.readouterr().err


def test_the_numbers_are_in_the_query_views(run):
    counted = query("SELECT count(DISTINCT device_id) n, stddev(value) s FROM irregularities WHERE level = 'die'", run)
    assert counted["n"].to_pylist() == [1200]
    assert counted["s"].to_pylist()[0] == pytest.approx(1.0, abs=0.02)
    meaning = query("SELECT unit, meaning FROM columns WHERE \"table\" = 'irregularities' AND name = 'value'", run)
    assert meaning["unit"].to_pylist() == ["1"]


def test_the_page_has_a_section_and_a_table(tmp_path):
    config = judged_config(tmp_path, 60)
    judged_run(tmp_path, config)

    def rendered(tables):
        return render_run_report(tables, config.judged_by(), attribution=attribution_of(config, tables))

    page = with_run(tmp_path, None, rendered)
    section = page[page.index('<section id="sources">') :]
    section = section[: section.index("</section>")]
    assert section.count("<svg") == 1
    assert "residual anisotropy, die" in section
    assert 'href="#sources"' in page


def test_what_a_parameter_spreads_is_found():
    spec = load_spec()
    assert len(spread_numbers(spec, "residual_anisotropy", "die_pct")) == 6
    assert len(spread_numbers(spec, "spring_width", "wafer_um")) == 1
    for name in ("fraction", "ln_mean"):
        assert spread_numbers(spec, "lid_leak", name) is None
    assert spread_numbers(spec, "spring_width", "bow_um") is None
    assert spread_numbers(spec, "spring_width", "wedge_um") is None  # it is zero
    assert spread_numbers(spec, "spring_thickness", "field_length_mm") is None


def test_blocks_without_numbers_are_skipped(tmp_path):
    """A run that an earlier version began and this one resumed: its first block has no irregularities."""
    config = judged_config(tmp_path, 120)
    judged_run(tmp_path / "whole", config, block=60)
    judged_run(tmp_path / "later", config, block=60, first_stored=1)
    whole, later = (
        with_run(
            tmp_path / name, None, lambda t, n=name: stored_numbers(find_run(tmp_path / n), Devices(t.devices), 10**6)
        )
        for name in ("whole", "later")
    )
    assert (len(whole.rows), len(later.rows)) == (120, 60)
    np.testing.assert_array_equal(whole.values[60:], later.values)
    np.testing.assert_array_equal(later.rows, np.arange(60, 120))
    np.testing.assert_array_equal(later.index, later.rows)


def test_a_population_without_loss_has_no_bars():
    nothing = OutputShares("loss", 0.0, ())
    section = loss_sources(Attribution(100, (nothing,), None))
    assert section.figure is None
    assert "nothing to attribute" in section.summary
    assert any("nothing to attribute" in line for line in attribution_lines(Attribution(100, (nothing,), None)))


def test_names_and_levels_of_own_irregularities_cannot_break_the_figure():
    share = IntervalEstimate(0.5, 0.1, 0.3, 0.7)
    own = OutputShares("loss", 0.1, (SourceShare(Source("a$b<script>", "batch"), share),))
    drawing = loss_sources(Attribution(100, (own,), None)).figure
    assert drawing is not None
    figure = drawing.__html__()
    assert "<script>" not in figure
    assert "a$b&lt;script&gt;, batch" in figure


def test_quantities_that_do_not_depend_on_the_operation_are_the_same_without_the_others() -> None:
    config = RunConfig()
    drawn, gain = draw(population(config), 3, 0, 20).true, population(config).angular_gain
    whole = true_quantities(config, drawn, gain)
    few = true_quantities(config, drawn, gain, ["quality1", "rate_bias_dps"])
    assert whole.keys() > few.keys() >= {"quality1", "rate_bias_dps"}
    assert all(np.array_equal(values, whole[name]) for name, values in few.items())
    assert true_quantities(config, drawn, gain, ["bandwidth_hz"]).keys() == whole.keys()
