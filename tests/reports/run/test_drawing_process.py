"""A second process draws figures of a page: the page is the same with it, without it, and when it fails."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from reports.devices import Devices
from reports.html import drawing_process
from reports.html.drawing_process import DrawingProcess, drawing_beside, drawn
from reports.html.style import Drawing, panels, style
from reports.limits import DEFAULT_LIMITS
from reports.run import FIGURES, figures
from reports.run.content import run_content
from reports.run.figures.causes import CauseBar, pareto_bars
from reports.run.page import render_run_report

BARS = [partial(pareto_bars, [CauseBar("split", k, 1)], 10) for k in range(1, 10)]


@pytest.fixture(scope="module")
def process() -> Iterator[DrawingProcess]:
    process = DrawingProcess(FIGURES)
    # It is there before the first page is drawn.
    process._ready = process._answer()[0]
    assert process._ready
    yield process
    process.close()


def slow(ask: Callable[[], Drawing | None], seen: list[int]) -> Drawing | None:
    """Note that this process draws."""
    seen.append(os.getpid())
    return ask()


def test_figures_of_both_processes_are_those_of_one_in_their_order(process: DrawingProcess) -> None:
    alone = drawn(BARS)
    assert len({str(figure) for figure in alone}) == len(BARS)
    done, figure = process._drawn(BARS[3])
    assert done
    assert figure == str(alone[3])
    assert drawn(BARS, process) == alone


def test_a_page_is_the_same_with_a_second_process_and_all_its_figures_can_be_sent(
    process: DrawingProcess, synthetic_run: Callable[..., Any]
) -> None:
    run = synthetic_run()
    assert render_run_report(run, DEFAULT_LIMITS, beside=process) == render_run_report(run, DEFAULT_LIMITS)
    asked = figures.figures_asked(Devices(run.devices), run_content(run, DEFAULT_LIMITS, None, None, {}))
    for name, ask in asked.items():
        assert ask is None or pickle.loads(pickle.dumps(ask)).func is ask.func, name


def test_a_figure_that_cannot_be_sent_is_drawn_here(process: DrawingProcess) -> None:
    seen: list[int] = []
    unsent = [lambda ask=ask: slow(ask, seen) for ask in BARS]
    assert drawn(unsent, process) == drawn(BARS)
    assert seen == [os.getpid()] * len(BARS)


def test_an_error_of_a_figure_is_that_of_a_page_without_the_process(process: DrawingProcess) -> None:
    wrong = partial(pareto_bars, None, 10)
    with pytest.raises(TypeError) as alone:
        drawn([*BARS, wrong])
    with pytest.raises(TypeError) as beside:
        drawn([*BARS, wrong], process)
    assert str(beside.value) == str(alone.value)


def test_a_process_that_is_killed_costs_no_figure() -> None:
    process = DrawingProcess(FIGURES)
    os.kill(process._process.pid, signal.SIGKILL)
    try:
        assert drawn(BARS, process) == drawn(BARS)
    finally:
        process.close()


def test_a_process_ends_with_its_page_and_is_not_started_on_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing_process, "usable_cores", lambda: 2)
    with drawing_beside(FIGURES) as beside:
        assert beside is not None
    assert beside._process.returncode == -signal.SIGKILL
    monkeypatch.setattr(drawing_process, "usable_cores", lambda: 1)
    with drawing_beside(FIGURES) as beside:
        assert beside is None


def test_cyclic_garbage_is_collected_again_after_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    collector = SimpleNamespace(
        isenabled=lambda: True, disable=lambda: calls.append("off"), enable=lambda: calls.append("on")
    )
    monkeypatch.setattr(drawing_process, "gc", collector)

    def draw() -> Drawing:
        calls.append("figure")
        with style():
            return Drawing(panels(1, 1, 1.0)[0], "empty", "Nothing")

    drawn([draw])
    assert calls == ["off", "figure", "on"]
