"""The page of a lot says what compare, diagnose and refine say, and adds and removes irregularities as they do."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from pipeline.learning.lot.loop import first_rung
from reports.words.explore_lot import STACKED
from tests.metal_lot import write_metal_lot
from tests.workflows.explore.pages import opened, press, source, titled, words
from workflows.cli import call
from workflows.explore.lot import view
from workflows.lots.loop import lot_answers
from workflows.lots.measured import read_measured_lot
from workflows.lots.page import maps_of

BOW = "fixed_bow(thickness)"


@pytest.fixture(scope="module")
def lot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lot with a bow that its nested spreads lack."""
    folder = tmp_path_factory.mktemp("metal")
    write_metal_lot(folder)
    return folder


@pytest.fixture(scope="module")
def page(lot: Path) -> Callable[[Any], None]:
    """The view; its sessions share the fits."""
    return view(lot)


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    capsys.readouterr()
    assert call([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_page_shows_the_words_of_compare_and_the_scores_of_diagnose(page, lot, capsys):
    document = opened(page)
    call(["compare", str(lot)])
    assert all(line in words(document) for line in capsys.readouterr().out.strip().splitlines())
    found = answer(capsys, "diagnose", str(lot))
    offered = [name for name, _ in titled(document, "Irregularity to add").options]
    assert offered[: len(found["candidates"])] == [one["part"] for one in found["candidates"]]
    assert offered[0] == BOW
    assert "An irregularity is missing" in words(document) or "One irregularity is missing" in words(document)


def test_an_added_irregularity_moves_the_forecast_as_refine_does(page, lot, capsys):
    document = opened(page)
    press(document, "Add and refit")
    ladder = answer(capsys, "refine", str(lot))["ladder"]
    assert [rung["irregularity"] for rung in ladder] == [None, BOW]
    shown = source(document, "mean", "low", "high").data
    for column in ("mean", "low", "high"):
        wanted = [100.0 * rung["forecast"][column] for rung in ladder]
        assert shown[column] == pytest.approx(wanted, rel=1e-12)
    assert shown["mean"][0] != shown["mean"][1]
    scores = source(document, "score").data["score"]
    assert scores == pytest.approx([rung["log_score_validate"] for rung in ladder], rel=1e-12)
    assert scores[1] > scores[0]
    for rung in ladder:
        assert f"{rung['error_fit']:.4g}".rstrip("0") in words(document)
    assert ladder[1]["status"] in words(document)
    press(document, "Remove")
    assert len(source(document, "mean", "low", "high").data["mean"]) == 1


def test_an_irregularity_that_refine_refuses_is_told_so(page):
    document = opened(page)
    offered = titled(document, "Irregularity to add")
    weak = [name for name, _ in offered.options if name.startswith("device_spread") or "resistance" in name][-1]
    offered.value = weak
    press(document, "Add and refit")
    assert f"Refine would not add {weak}: " in words(document)
    assert "refused" in words(document)


def test_the_maps_hold_the_residuals_of_the_fitted_devices(page, lot):
    document = opened(page)
    maps = maps_of(first_rung(lot_answers(read_measured_lot(lot)).ready))
    titled(document, "Quantity").value = "thickness"
    wafer = titled(document, "Wafer")
    drawn, after = (
        next(one for one in document.models if one.name == f"Residual map: {which}").renderers[1].data_source
        for which in ("given population, refitted", "with the added irregularities")
    )
    assert len(drawn.data["z"]) == len(maps.wafers)
    for name in wafer.options[1:]:
        wafer.value = name
        own = np.array(maps.wafers) == name
        np.testing.assert_allclose(np.sort(drawn.data["z"]), np.sort(maps.z[own, 0]))
    wafer.value = STACKED
    assert len(after.data["z"]) == 0
    press(document, "Add and refit")
    assert len(after.data["z"]) == len(drawn.data["z"])
    bow = np.hypot(after.data["x"], after.data["y"])
    # The bow that the first model leaves is gone with the added pattern.
    before = abs(np.corrcoef(np.hypot(drawn.data["x"], drawn.data["y"]), drawn.data["z"])[0, 1])
    assert abs(np.corrcoef(bow, after.data["z"])[0, 1]) < 0.2 < before


def test_an_unknown_irregularity_is_one_line_and_the_model_before_stays(page):
    document = opened(page)
    offered = titled(document, "Irregularity to add")
    offered.options = [*offered.options, ("glue", "glue")]
    offered.value = "glue"
    press(document, "Add and refit")
    failed = [one.text for one in document.models if 'role="alert"' in str(getattr(one, "text", ""))]
    assert len(failed) == 1
    assert "no such irregularity" in failed[0]
    assert titled(document, "Added irregularity").options == []


def test_files_of_another_kind_are_one_typed_line(lot, tmp_path, capsys):
    small = tmp_path / "small"
    small.mkdir()
    lines = (lot / "metal.csv").read_text().splitlines()
    (small / "metal.csv").write_text("\n".join(lines[:15]))
    (small / "lot.toml").write_text((lot / "lot.toml").read_text() + "[hold]\nshare = 0.0\n")
    for arguments, message in (
        ([str(lot), "--model", "m.toml"], "--model belongs to a campaign"),
        ([str(lot), "--effects", "mine"], "--effects belongs to a campaign"),
        ([str(lot), "--population", "cloverleaf"], "a population file describes gyros"),
        ([str(lot), "--limits", "none.toml"], "none.toml"),
        ([str(small)], "too few devices"),
    ):
        capsys.readouterr()
        assert call(["explore", *arguments, "--no-browser"]) == 2, arguments
        failed = capsys.readouterr().err.strip().splitlines()
        assert len(failed) == 1
        assert message in failed[0]
