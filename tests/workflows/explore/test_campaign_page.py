"""The page of a campaign says what compare, diagnose and refine say, and adds and removes effects as they do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

import workflows
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.campaign import read_measurement
from tests.workflows.explore.pages import EFFECT, opened, press, settle, source, titled, words, write_small_campaign
from workflows.cli import call
from workflows.explore.campaign import view
from workflows.explore.campaign.bench import CampaignBench
from workflows.explore.campaign.next_panel import difference
from workflows.explore.campaign.residual_panels import ResidualPanels
from workflows.explore.worker import line_of

#: The modal record of the paper, as the benchmark of the paper ships it.
EQ14 = Path(workflows.__file__).with_name("configs") / "eq14.toml"
Filled = Callable[[Any], None]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory, brief_records_of_module: None) -> Path:
    """A campaign with a hidden effect that is linear, so that fits take no time."""
    folder = tmp_path_factory.mktemp("campaign") / "c12"
    write_small_campaign(folder)
    return folder


@pytest.fixture(scope="module")
def page(campaign: Path) -> Filled:
    """The view; its sessions share the fits."""
    return view(campaign)


@pytest.fixture(scope="module")
def bench(campaign: Path) -> CampaignBench:
    """What the page computes."""
    return CampaignBench(read_measurement(campaign), DEFAULT_COMPARE_MODEL)


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    capsys.readouterr()
    assert call([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_page_shows_the_figures_of_compare_and_diagnose(page, campaign, capsys):
    document = opened(page)
    compared = answer(capsys, "compare", str(campaign))
    errors = source(document, "fit", "held").data
    assert errors["fit"] == [pytest.approx(compared["error"]["fit"], rel=1e-12)]
    assert errors["held"] == [pytest.approx(compared["error"]["validate"], rel=1e-12)]
    call(["compare", str(campaign)])
    printed = capsys.readouterr().out.strip().splitlines()
    assert all(line.replace("&", "&amp;") in words(document) for line in printed)
    found = answer(capsys, "diagnose", str(campaign))
    offered = titled(document, "Effect to add")
    assert [name for name, _ in offered.options] == [one["effect"] for one in found["candidates"]]
    assert offered.value == found["effects"][0] == EFFECT
    assert f"{found['verdict']}: What is missing: off-diagonal damping." in words(document)


def test_an_added_effect_lowers_the_error_as_the_commands_do(page, campaign, tmp_path, capsys):
    document = opened(page)
    press(document, "Add and refit")
    ladder = answer(capsys, "refine", str(campaign))["ladder"]
    errors = source(document, "fit", "held").data
    assert errors["fit"] == [pytest.approx(rung["error_fit"], rel=1e-12) for rung in ladder]
    assert errors["held"] == [pytest.approx(rung["error_validate"], rel=1e-12) for rung in ladder]
    model = tmp_path / "model.toml"
    model.write_text(f'plant = "gyro"\neffects = ["{EFFECT}"]\n')
    given = answer(capsys, "compare", str(campaign), "--model", str(model))["error"]
    # Another start of the same fit ends within its convergence.
    assert errors["fit"][1] == pytest.approx(given["fit"], rel=1e-6)
    assert errors["held"][1] == pytest.approx(given["validate"], rel=1e-6)
    assert ladder[-1]["status"] == "confirmed"
    assert "confirmed" in words(document)
    assert "adequate: " in words(document)
    press(document, "Remove")
    assert source(document, "fit", "held").data["fit"] == errors["fit"][:1]
    assert "confirmed" not in words(document)


def test_an_effect_that_refine_refuses_is_told_so(page):
    document = opened(page)
    titled(document, "Effect to add").value = "pickoff_pole"
    press(document, "Add and refit")
    assert "Refine would not add pick-off pole: after its refit, it explains less than 15 % of the misfit." in words(
        document
    )
    assert "refused" in words(document)
    assert titled(document, "Effect to add").value == EFFECT


def test_wishes_that_come_quickly_end_with_the_last_one(page):
    document = opened(page)
    add = next(one for one in document.models if getattr(one, "label", None) == "Add and refit")
    remove = next(one for one in document.models if getattr(one, "label", None) == "Remove")
    from bokeh.events import ButtonClick

    for button in (add, remove, add):
        button._trigger_event(ButtonClick(button))
    settle(document)
    assert len(source(document, "fit", "held").data["fit"]) == 2
    assert words(document).count("Ready.") == 1


def test_what_fails_is_one_line_and_the_model_before_stays(page):
    document = opened(page)
    offered = titled(document, "Effect to add")
    offered.options = [*offered.options, ("spring_of_rubber", "spring of rubber")]
    offered.value = "spring_of_rubber"
    press(document, "Add and refit")
    failed = [one.text for one in document.models if 'role="alert"' in str(getattr(one, "text", ""))]
    assert len(failed) == 1
    assert "no such effect" in failed[0]
    assert "allowed:" in failed[0]
    assert "Traceback" not in failed[0]
    assert source(document, "fit", "held").data["fit"][0] > 10.0
    assert titled(document, "Effect in the model").options == []
    assert line_of(ValueError("a\nb")) == "internal error: ValueError: a\\nb"


def test_the_residual_is_that_of_the_record_in_volts_and_in_sigmas(page, bench):
    document = opened(page)
    views = {one.name: one for one in bench.first}
    record, unit = titled(document, "Record"), titled(document, "Unit")
    time = next(one for one in document.models if getattr(one, "name", None) == "Residual by time")
    spectrum = next(one for one in document.models if getattr(one, "name", None) == "Residual by frequency")
    curve = next(one.data_source for one in time.renderers if "y" in one.data_source.data)
    assert set(views) == {name for name, _ in record.options}
    record.value = "chirp-low"
    residual = views["chirp-low"].residual[:, 0]
    blocks = np.asarray(curve.data["y"])
    assert np.sqrt(np.mean(blocks**2)) == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0.01)
    unit.value = "V"
    volts = np.asarray(curve.data["y"])
    left = views["chirp-low"].measured_v[:, 0] - views["chirp-low"].model_v[:, 0]
    assert np.sqrt(np.mean(volts**2)) == pytest.approx(left.std(), rel=0.01)
    for name, _ in record.options:
        record.value = name
        for channel in titled(document, "Sense").options:
            titled(document, "Sense").value = channel
            for band in titled(document, "Band of the spectrum").options:
                titled(document, "Band of the spectrum").value = band
                assert len(spectrum.renderers[0].data_source.data["measured"]) > 10


def test_the_next_record_of_a_linear_effect_scales_with_its_drive(page, bench):
    document = opened(page)
    press(document, "Add and refit")
    assert titled(document, "Without and with").value == EFFECT
    assert "with all parameters refitted" in words(document)
    experiment = bench.experiments((), EFFECT)[0]
    one, half = (bench.next_record((), EFFECT, experiment.scaled(scale)) for scale in (1.0, 0.5))
    assert one.apart == pytest.approx(2.0 * half.apart, rel=1e-6)
    assert one.snr > half.snr > one.known > 0.0
    view_ = difference(one)
    # What is free in every record takes a little of the difference.
    assert np.sqrt(np.sum(view_.residual**2)) == pytest.approx(one.apart, rel=0.01)
    scale = titled(document, "Level scale (1: as measured so far)")
    scale.value = 0.5
    scale.trigger("value_throttled", 1.0, 0.5)
    settle(document)
    assert f"{experiment.scaled(0.5).level_v:.3g} V, 1 s" in words(document)


def test_a_record_without_a_drive_predicts_nothing(bench, campaign):
    from pipeline.errors import UsageError
    from pipeline.learning.next_experiment.predicted import next_experiments

    problem = bench._answers.problem
    silent = [replace(one, drive_v=np.zeros_like(one.drive_v)) for one in problem.campaign.records]
    quiet = problem.with_records(replace(problem.campaign, records=tuple(silent)), problem.noise)
    with pytest.raises(UsageError, match="without one"):
        next_experiments(quiet, (), EFFECT)


def test_a_modal_record_has_no_residuals_to_draw_and_no_next_record():
    bench = CampaignBench(read_measurement(EQ14), DEFAULT_COMPARE_MODEL)
    assert bench.comparison.fit_ok
    residual = ResidualPanels()
    residual.show(bench.first, (), {})
    assert "no samples, sweeps or decays to draw" in residual.note.text
    assert residual.record.options == []
    assert not bench.predicts
