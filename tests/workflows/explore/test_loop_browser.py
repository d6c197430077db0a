"""The pages of campaigns and lots in Chromium: keyboard, narrow and dark windows, the figures of the commands."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from tests.metal_lot import write_metal_lot
from tests.workflows.explore.conftest import served
from tests.workflows.explore.pages import write_small_campaign
from workflows.cli import call
from workflows.explore.campaign import view as campaign_view
from workflows.explore.lot import view as lot_view


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    capsys.readouterr()
    assert call([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def ready(seen: Any, words: str) -> None:
    """Wait until nothing is computed any more and the page says ``words``."""
    seen.page.get_by_text(words).first.wait_for(timeout=120_000)
    seen.page.get_by_text("Ready.", exact=True).wait_for(timeout=120_000)
    seen.settle()


def ladder(seen: Any) -> list[list[str]]:
    """The cells of the first table of the page, row by row, after the head."""
    rows = seen.page.get_by_role("table").first.get_by_role("row").all()
    return [[cell.inner_text() for cell in row.get_by_role("cell").all()] for row in rows][1:]


def test_an_added_effect_lowers_the_error_as_refine_does(tmp_path: Path, visit: Any, capsys: Any, brief_records: None):
    folder = tmp_path / "c12"
    write_small_campaign(folder)
    wanted = answer(capsys, "refine", str(folder))["ladder"]
    with served(campaign_view(folder)) as address:
        seen = visit(address, width=400, height=800, dark=True)
        ready(seen, "What is missing: off-diagonal damping.")
        # By keyboard alone: from the list of effects to the button that adds the named one.
        seen.page.get_by_label("Effect to add").focus()
        seen.page.keyboard.press("Tab")
        seen.page.keyboard.press("Enter")
        ready(seen, "Nothing is missing")
        shown = [(float(row[2]), float(row[3])) for row in ladder(seen)]
        assert shown == [
            (pytest.approx(rung["error_fit"], rel=1e-3), pytest.approx(rung["error_validate"], rel=1e-3))
            for rung in wanted
        ]
        assert shown[1][1] < shown[0][1]
        assert [row[1] for row in ladder(seen)] == ["", "confirmed"]
        assert seen.widest() <= 0
        assert seen.complaints == []
        assert seen.foreign() == []


def test_an_added_irregularity_moves_the_forecast_as_refine_does(tmp_path: Path, visit: Any, capsys: Any):
    write_metal_lot(tmp_path)
    wanted = [rung["forecast"] for rung in answer(capsys, "refine", str(tmp_path))["ladder"]]
    with served(lot_view(tmp_path)) as address:
        seen = visit(address, width=400, height=800)
        ready(seen, "irregularity is missing")
        seen.page.get_by_label("Irregularity to add").focus()
        seen.page.keyboard.press("Tab")
        seen.page.keyboard.press("Enter")
        ready(seen, "with fixed_bow(thickness)")
        for row, found in zip(ladder(seen), wanted, strict=True):
            mean, low, high, measured = (float(one) for one in re.findall(r"\d+\.\d", row[-1])[:4])
            assert mean == pytest.approx(100 * found["mean"], abs=0.051)
            assert (low, high) == (
                pytest.approx(100 * found["low"], abs=0.051),
                pytest.approx(100 * found["high"], abs=0.051),
            )
            assert measured == pytest.approx(100 * found["measured"], abs=0.051)
        assert seen.widest() <= 0
        assert seen.complaints == []
        assert seen.foreign() == []
