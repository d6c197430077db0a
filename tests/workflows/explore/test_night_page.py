"""The page of a night without a browser: a document, its widgets, and what they do."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.stub_runs import run_arguments, stub_block, stub_runs
from workflows.cli import call

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from bokeh.document import Document
from bokeh.events import SelectionGeometry
from bokeh.server.callbacks import NextTickCallback

from pipeline.errors import IntegrityError
from reports.words.explore import EXACT, PREVIEW, READING_DRAWS, UNITS, label
from workflows.explore.night import limits_panel, panels
from workflows.explore.night.device import device_view
from workflows.explore.night.device_panel import DevicePanel
from workflows.explore.night.figures import places
from workflows.explore.night.limits_panel import LimitsPanel
from workflows.explore.night.markup import note_html
from workflows.explore.night.points_panels import PointsPanels
from workflows.explore.night.state import NightState
from workflows.explore.night.stored import NightData, load


class Inline(Executor):
    """Work is done when it is submitted."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """``function`` at once."""
        found: Future[Any] = Future()
        try:
            found.set_result(function(*arguments, **named))
        except Exception as error:
            found.set_exception(error)
        return found

    def stop(self, wanted: Future[Any]) -> None:
        """There is nothing left to stop."""


@pytest.fixture(scope="module")
def stored(night: Path) -> NightData:
    return load(night)


@pytest.fixture
def state(stored: NightData) -> NightState:
    return NightState(stored, Document(), Inline(), Inline())


def pass_time(state: NightState) -> None:
    """Run what waits for a pause or for the next tick, until nothing does."""
    document = state.document
    for _ in range(10):
        waiting = document.session_callbacks
        if not waiting:
            return
        for one in waiting:
            one.callback()
    raise AssertionError("callbacks without end")


def command_says(stored: NightData, text: str, folder: Path, capsys: Any) -> dict[str, Any]:
    """The yields of ``gyroscreen report --limits``."""
    path = folder / "new.toml"
    path.write_text(text, encoding="utf-8")
    arguments = ["report", "--results", str(stored.results), "--limits", str(path), "--out", str(folder / "page.html")]
    assert call([*arguments, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found["yield"]


def next_tick(state: NightState) -> None:
    """Run the one answer that waits for the next tick."""
    (answer,) = [one for one in state.document.session_callbacks if isinstance(one, NextTickCallback)]
    state.document.remove_next_tick_callback(answer)
    answer.callback()


def test_a_moved_line_is_previewed_and_then_judged_as_the_command_does(
    state: NightState, stored: NightData, tmp_path: Path, capsys: Any
) -> None:
    for panel in panels(state):
        state.document.add_root(panel.model)
    total, file = (state.document.get_model_by_name(name) for name in ("yield", "file"))
    figure = state.document.get_model_by_name("Limits and distribution")
    line = [one for one in figure.center if type(one).__name__ == "Span"][1]
    first = state.judged.total.passed
    line.location = 532.2
    assert PREVIEW in total.text
    preview = state.judged.total
    pass_time(state)
    assert EXACT in total.text
    assert state.judged.total == preview
    assert preview.passed < first
    says = command_says(stored, file.text, tmp_path, capsys)["new"]
    assert (says["pass"], says["fail"], says["undecided"]) == (preview.passed, preview.failed, preview.undecided)
    assert (says["low"], says["high"]) == (preview.clopper_pearson.low, preview.clopper_pearson.high)
    assert f"{100 * says['yield']:.1f}" in total.text


def test_many_movements_are_answered_together(state: NightState, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits_panel, "perf_counter", lambda: 5.0)
    panel = LimitsPanel(state)
    told: list[float] = []
    state.follow("verdicts", lambda: told.append(state.judged.total.value))
    for value in np.linspace(535.0, 530.0, 20):
        panel.distribution.high.location = float(value)
    assert len(told) == 1  # the first one, at once
    panel.dragged()
    assert len(told) == 2  # all others, together
    assert panel.limit().high == 530.0


def test_fields_and_lines_say_the_same(state: NightState) -> None:
    panel = LimitsPanel(state)
    panel.high.value = 531.5
    assert panel.distribution.high.location == 531.5
    assert panel.limit().low == 522.0
    panel.high.value = None
    assert not panel.distribution.high.visible
    assert math.isinf(panel.limit().high)
    pass_time(state)
    panel._restore()
    assert panel.high.value == 536.0
    assert state.judged.against_run == ""


def test_a_limit_of_another_quantity_can_be_added(state: NightState) -> None:
    panel = LimitsPanel(state)
    panel.quantity.value = "theta_deg"
    assert (panel.low.value, panel.high.value) == (None, None)
    panel.low.value = -20.0
    # An arc needs both ends.
    assert "arc" in state.message
    assert "theta_deg" not in state.limits.quantities
    panel.high.value = 60.0
    assert state.message == ""
    pass_time(state)
    assert state.judged.exact
    assert state.judged.limits.quantities[-1] == "theta_deg"


def test_crossed_limits_are_said_and_change_nothing(state: NightState) -> None:
    panel = LimitsPanel(state)
    panel.low.value = 9000.0
    assert "crossed" in state.message
    assert state.limits == state.night.limits
    assert panel.distribution.low.location == 522.0
    panel.low.value = 523.0
    assert state.message == ""
    assert panel.limit().low == 523.0


def test_a_selection_is_one_in_all_figures(state: NightState, stored: NightData) -> None:
    limits, points = LimitsPanel(state), PointsPanels(state)
    points.points.selected.indices = [2, 3, 5]
    assert state.selected.tolist() == points.rows[[2, 3, 5]].tolist()
    assert sum(limits.distribution.selected.data["y"]) == np.isfinite(stored.value("f1_hz")[state.selected]).sum()
    assert points.pair.renderers[0].data_source is points.points
    event = SelectionGeometry(None, {"type": "rect", "x0": 531.0, "x1": 533.2}, final=True)
    limits._range(event)
    value = stored.value("f1_hz")
    inside = np.flatnonzero((value >= 531.0) & (value <= 533.2))
    assert inside.size > 2
    assert points.rows[points.points.selected.indices].tolist() == inside.tolist()


def test_a_wafer_can_be_chosen_and_a_map_coloured(state: NightState, stored: NightData) -> None:
    LimitsPanel(state)
    points = PointsPanels(state)
    name = stored.wafer_names[0]
    points.wafer.value = name
    assert {stored.wafers[row] for row in points.rows} == {name}
    points.colour.value = "split_hz"
    assert points.points.data["c"].tolist() == pytest.approx(
        stored.value("split_hz")[points.rows].tolist(), nan_ok=True
    )
    assert points.map.numbers.visible
    assert not points.map.verdicts.visible


def test_wafers_are_drawn_apart(stored: NightData) -> None:
    found = places(stored, "")
    assert len(found.centres) == len(stored.wafer_names)
    radius = [
        math.hypot(found.x[k] - x, found.y[k] - y) for k in range(24) for x, y in [found.centres[stored.wafers[k]]]
    ]
    assert max(radius) <= 1.0


def test_a_device_shows_verdict_reasons_and_residual(state: NightState, stored: NightData) -> None:
    panel = DevicePanel(state)
    row = next(k for k, text in enumerate(stored.devices.text("failed_limits")) if text == "split_hz")
    panel.name.value = stored.device_ids[row]
    assert f"fail, by {label('split_hz')}" in panel.details.text
    pass_time(state)
    assert panel.curves.residual.visible
    assert panel.looked is not None
    # The records are those that the screening saw: its error is found again.
    assert panel.looked.error == pytest.approx(float(stored.value("error")[row]), rel=0.01)
    panel.channel.value = "1"
    assert panel.curves.band.data["low"].tolist() == panel.looked.low[:, 1].tolist()
    panel.name.value = "<b>nobody</b>"
    assert "&lt;b&gt;nobody" in panel.details.text


def test_a_device_without_estimates_says_why(state: NightState, stored: NightData) -> None:
    panel = DevicePanel(state)
    row = int(np.flatnonzero(~np.isfinite(stored.value("f1_hz")))[0])
    panel.name.value = stored.device_ids[row]
    pass_time(state)
    assert "no estimates to start from" in panel.left.text
    assert not panel.curves.residual.visible


def test_a_view_of_a_device_is_the_same_every_time(stored: NightData) -> None:
    first, second = device_view(stored, 9), device_view(stored, 9)
    assert first.low.tolist() == second.low.tolist()


def test_all_units_are_known(stored: NightData) -> None:
    assert set(stored.known) <= set(UNITS)


class Waiting(Inline):
    """Work is done when the test says so."""

    def __init__(self) -> None:
        self.asked: list[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]]] = []
        self.stopped: list[Future[Any]] = []

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Keep it."""
        self.asked.append((Future(), function, arguments))
        return self.asked[-1][0]

    def stop(self, wanted: Future[Any]) -> None:
        """Keep it."""
        self.stopped.append(wanted)


def test_a_movement_ends_the_judgement_of_the_limits_before(stored: NightData) -> None:
    judge = Waiting()
    state = NightState(stored, Document(), Inline(), judge)
    state.take("f1_hz", 522.0, 533.0)
    state._rested()
    state.take("f1_hz", 522.0, 531.0)
    state.take("f1_hz", 522.0, 533.0)
    ((future, function, arguments),) = judge.asked
    assert judge.stopped == [future]
    now = state.judged
    # Its answer comes too late, though the limits are the same again.
    future.set_result(function(*arguments))
    next_tick(state)
    assert state.judged is now
    assert not now.exact


def test_a_judgement_that_fails_is_said_in_one_line(stored: NightData) -> None:
    judge = Waiting()
    state = NightState(stored, Document(), Inline(), judge)
    for error, words in (
        (IntegrityError("a file is not what was committed"), "committed"),
        (ValueError("a"), "internal"),
    ):
        state.take("f1_hz", 522.0, 533.0 if words == "committed" else 532.0)
        state._rested()
        judge.asked[-1][0].set_exception(error)
        next_tick(state)
        assert words in state.message
        assert "\n" not in state.message


def test_the_fields_of_a_quantity_wait_for_its_draws(night: Path) -> None:
    worker = Waiting()
    state = NightState(load(night), Document(), worker, Inline())
    panel = LimitsPanel(state)
    assert not panel.low.disabled
    panel.quantity.value = "f3_hz"
    assert (panel.low.disabled, panel.high.disabled, panel.reading.text) == (True, True, note_html(READING_DRAWS))
    panel.quantity.value = "f1_hz"
    assert not panel.low.disabled
    panel.quantity.value = "f3_hz"
    future, function, arguments = worker.asked[-1]
    future.set_result(function(*arguments))
    pass_time(state)
    assert (panel.low.disabled, panel.reading.visible) == (False, False)
    panel.quantity.value = "f1_hz"
    panel.quantity.value = "f3_hz"
    assert not panel.low.disabled


def test_a_night_without_an_identified_device_states_no_yield(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stub_runs(monkeypatch, stub_block("fit_failed", "no maximum"))
    assert call([*run_arguments(tmp_path), "--json"]) == 1
    (run,) = (tmp_path / "results").glob("run=*")
    state = NightState(load(run), Document(), Inline(), Inline())
    for panel in panels(state):
        state.document.add_root(panel.model)
    text = state.document.get_model_by_name("yield").text
    assert "No device of this run could be identified" in text
    assert "%" not in text
