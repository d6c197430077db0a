"""Time from the movement of a limit in the browser to the new yield on the page, and processor time of one answer.

usage: python -m tests.measure.explore_drag [DEVICES]; the default is 100,000 (1.1 GB, made in half a minute).  Needs Chromium.

The page stamps each movement of the pointer and each new text of the yield.  "one step": the pointer moves once and waits for the
answer.  "sweep": the pointer moves 60 times without waiting; the time is from the last movement to the last text.  Wall time on a
busy machine says little, so the load is printed too.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.document import Document
from playwright.sync_api import Page, sync_playwright

from tests.measure.what_if_time import stub_run
from tests.workflows.explore.conftest import ARGUMENTS, chromium
from tests.workflows.explore.night_page import END, Dragged
from workflows.explore.night import panels
from workflows.explore.night.state import NightState
from workflows.explore.night.stored import load

_STEPS = 30
FORGET = "() => { window.moved = []; window.told = []; }"
STAMPS = """() => {
  const total = Bokeh.documents[0].get_model_by_name("yield");
  window.moved = []; window.told = [];
  window.addEventListener("pointermove", () => window.moved.push(performance.now()), true);
  total.properties.text.change.connect(() => requestAnimationFrame(() => window.told.push(performance.now())));
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
    state = NightState(night, Document(), ThreadPoolExecutor(1))
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


def _single(page: Page) -> list[float]:
    line = Dragged(**page.evaluate(END, 1))
    page.mouse.move(line.x, line.y)
    page.mouse.down()
    found = []
    for k in range(1, _STEPS + 1):
        page.evaluate(FORGET)
        page.mouse.move(line.x - 6 * k, line.y)
        stamps = _answered(page, 0)
        if stamps[1]:
            found.append(stamps[1][0] - stamps[0][0])
    page.mouse.up()
    _answered(page, 5_000)
    return found


def _sweep(page: Page) -> float:
    line = Dragged(**page.evaluate(END, 1))
    page.mouse.move(line.x, line.y)
    page.mouse.down()
    page.evaluate(FORGET)
    for k in range(1, 61):
        page.mouse.move(line.x + 3 * k, line.y)
    # The judgement at rest comes later and is no answer to the movement.
    moved, told = _answered(page, 230)
    page.mouse.up()
    return float(told[-1] - moved[-1])


def _answered(page: Page, quiet_ms: int) -> Any:
    """Stamps of movements and answers, once there is an answer and ``quiet_ms`` have passed without another."""
    stamps: Any = [[], []]
    for _ in range(2000):
        before, stamps = stamps, page.evaluate("() => [window.moved, window.told]")
        if stamps[1] and (quiet_ms == 0 or len(stamps[1]) == len(before[1])):
            break
        page.wait_for_timeout(max(quiet_ms, 5))
    return stamps


if __name__ == "__main__":
    main()
