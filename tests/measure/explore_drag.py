"""Time from the movement of a limit in the browser to the new yield on the page, and processor time of one answer.

usage: python -m tests.measure.explore_drag [DEVICES]; the default is 100,000 (1.1 GB, made in half a minute).  Needs Chromium.

The page stamps each movement of the pointer and each answer to it.  "one step": the pointer moves once and waits for the
answer.  The steps are 0.15 to 6 s apart, so that most of them fall into the judgement at rest, or into the moment at which it
replaces the preview.  "sweep": the pointer moves 60 times without waiting; the time is from the last movement to the last answer.
Wall time on a busy machine says little, so the load is printed too.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bokeh.document import Document
from playwright.sync_api import Page, sync_playwright

from reports.words.explore import PREVIEW
from tests.measure.what_if_time import stub_run
from tests.workflows.explore.conftest import ARGUMENTS, chromium
from tests.workflows.explore.night_page import END, Dragged
from workflows.explore.night import panels
from workflows.explore.night.state import NightState
from workflows.explore.night.stored import load
from workflows.explore.process import StoppableProcess
from workflows.explore.thread import DaemonThread

#: One cycle of steps, and how often it is repeated.
_PAUSES_S = (0.15, 0.3, 0.4, 0.6, 0.9, 1.3, 1.8, 2.5, 3.5, 6.0)
_CYCLES = 12
FORGET = "() => { window.moved = []; window.told = []; }"
TEXT = 'Bokeh.documents[0].get_model_by_name("yield").text'
TOLD = "[window.moved, window.told]"
#: The file of the limits is another after each movement, the yield may be the same; both come together.
STAMPS = """() => {
  const file = Bokeh.documents[0].get_model_by_name("file");
  window.moved = []; window.told = [];
  window.addEventListener("pointermove", () => window.moved.push(performance.now()), true);
  file.properties.text.change.connect(() => requestAnimationFrame(() => window.told.push(performance.now())));
}"""


def main() -> None:
    """Make the run, measure, print."""
    devices = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    with tempfile.TemporaryDirectory(prefix="gyroscreen-explore-") as folder:
        stub_run(Path(folder), devices)
        _processor_time(Path(folder) / "run=r", devices)
        _in_browser(folder, devices)


def _processor_time(run: Path, devices: int) -> None:
    start = time.process_time()
    night = load(run)
    read = time.process_time() - start
    state = NightState(night, Document(), DaemonThread("devices"), StoppableProcess("judge", "workflows"))
    panels(state)
    limit = night.limits.limits[0]
    ends = np.linspace(limit.low, 0.5 * (limit.low + limit.high), 23).tolist()
    for end in ends[:3]:
        state.take(limit.quantity, end, limit.high)
    start = time.process_time()
    for end in ends[3:]:
        state.take(limit.quantity, end, limit.high)
    each = (time.process_time() - start) / len(ends[3:])
    print(
        f"{devices} devices: {read:.1f} s of processor time to read, {1e3 * each:.0f} ms to answer one movement",
        flush=True,
    )


def _in_browser(folder: str, devices: int) -> None:
    command = [sys.executable, "-m", "workflows.cli", "explore", "--results", folder, "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        with sync_playwright() as driver:
            started = driver.chromium.launch(executable_path=chromium(), args=ARGUMENTS)
            page = started.new_page(viewport={"width": 1200, "height": 1000})
            page.goto(address)
            while not page.evaluate("Boolean(window.Bokeh && Bokeh.documents[0]?.is_idle)"):
                page.wait_for_timeout(50)
            page.wait_for_timeout(500)
            page.evaluate(STAMPS)
            single = _single(page)
            sweep = _sweep(page)
            started.close()
    finally:
        server.terminate()
        server.wait()
    load_ = os.getloadavg()[0]
    print(
        f"one step: {_shown(single)}; sweep of 60: {sweep:.0f} ms after the last; load {load_:.1f} on {os.cpu_count()} cores"
    )


def _shown(times: Sequence[float]) -> str:
    middle, most = np.median(times), max(times)
    return f"median {middle:.0f} ms, 90 % below {np.quantile(times, 0.9):.0f} ms, largest {most:.0f} ms of {len(times)}"


def _line(page: Page) -> Dragged:
    """The upper end of the limit, once the page has come to rest."""
    before, line = None, Dragged(**page.evaluate(END, 1))
    while line != before:
        page.wait_for_timeout(1000)
        before, line = line, Dragged(**page.evaluate(END, 1))
    return line


def _single(page: Page) -> list[float]:
    line = _line(page)
    page.mouse.move(line.x, line.y)
    page.mouse.down()
    # The first movement starts the drag and moves no line.
    page.mouse.move(line.x - 3, line.y)
    found = []
    for k in range(len(_PAUSES_S) * _CYCLES):
        page.wait_for_timeout(1e3 * _PAUSES_S[k % len(_PAUSES_S)])
        page.evaluate(FORGET)
        # To and fro: each place differs from the one before.
        page.mouse.move(line.x - 6 * (1 + k % 30), line.y)
        moved, told = _answered(page)
        found.append(told - moved)
    page.mouse.up()
    return found


def _sweep(page: Page) -> float:
    line = _line(page)
    page.mouse.move(line.x, line.y)
    page.mouse.down()
    page.evaluate(FORGET)
    for k in range(1, 61):
        page.mouse.move(line.x + 3 * k, line.y)
    # The last preview is there when the judgement has replaced it.
    while PREVIEW in page.evaluate(TEXT):
        page.wait_for_timeout(100)
    page.mouse.up()
    moved, told = page.evaluate(TOLD)
    return float(told[-1] - moved[-1])


def _answered(page: Page) -> tuple[float, float]:
    """Stamps of the movement and of its answer."""
    for _ in range(6000):
        moved, told = page.evaluate(TOLD)
        after = [one for one in told if moved and one > moved[0]]
        if after:
            return moved[0], after[0]
        page.wait_for_timeout(5)
    raise TimeoutError("a movement was not answered within 30 s")


if __name__ == "__main__":
    main()
