"""A server in a thread, and a page of it in Chromium that records what it says and asks for."""

from __future__ import annotations

import asyncio
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import tomli_w

from pipeline.store.run import create_run
from pipeline.toml_files import converted
from workflows.config import RunConfig, to_toml_table
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.plan import without_none

#: Names under which Chromium is installed; GYROSCREEN_CHROMIUM names another one.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


@contextmanager
def served(view: Callable[[Any], None]) -> Iterator[str]:
    """The address of a server of ``view``, which runs in a thread."""
    from workflows.explore.server import serve

    ready, address, tasks = threading.Event(), [], []

    async def run() -> None:
        tasks.append((asyncio.get_running_loop(), asyncio.current_task()))
        await serve(view, 0, lambda text: (address.append(text), ready.set()))

    def body() -> None:
        with suppress(asyncio.CancelledError):
            asyncio.run(run())

    thread = threading.Thread(target=body, daemon=True)
    thread.start()
    assert ready.wait(30), "the server does not listen"
    try:
        yield address[0]
    finally:
        loop, task = tasks[0]
        loop.call_soon_threadsafe(task.cancel)
        thread.join(30)
        assert not thread.is_alive(), "the server does not end"


def chromium() -> str | None:
    """The browser of this machine, or nothing."""
    named = os.environ.get("GYROSCREEN_CHROMIUM")
    return named or next((path for name in BROWSERS if (path := shutil.which(name))), None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium; the test is skipped where it or playwright is missing.

    While it lives, playwright keeps an event loop running in this thread, so that other tests could not start one.
    """
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = chromium()
    if path is None:
        pytest.skip("no Chromium is installed (GYROSCREEN_CHROMIUM names one)")
    with api.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield started
        started.close()


@dataclass
class Visit:
    """A page, what its console said, and the addresses that it asked for."""

    page: Any
    address: str
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def foreign(self) -> list[str]:
        """Requests to anything but the server."""
        own = urlsplit(self.address).netloc
        return [one for one in self.requests if not one.startswith("data:") and urlsplit(one).netloc != own]

    def until(self, what: str, seconds: float = 30.0) -> Any:
        """The value of a JavaScript expression as soon as it is true.

        Playwright's own waiting evaluates text within the page, which the page's policy forbids.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := self.page.evaluate(what):
                return value
            self.page.wait_for_timeout(30)
        raise AssertionError(f"the page never came to {what}")

    def settle(self) -> None:
        """Wait until Bokeh has drawn everything."""
        self.until("Boolean(window.Bokeh && Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle)")

    def widest(self) -> int:
        """Pixels by which the page is wider than the window."""
        return self.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Visit]]:
    """Opens a page: ``visit(address, width=1200, height=900, dark=False)``; waits until Bokeh has drawn it."""
    contexts = []

    def opened(address: str, width: int = 1200, height: int = 900, dark: bool = False) -> Visit:
        context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light"
        )
        contexts.append(context)
        found = Visit(context.new_page(), address)
        found.page.on("console", lambda m: found.complaints.append(m.text) if m.type in ("error", "warning") else None)
        found.page.on("pageerror", lambda error: found.complaints.append(str(error)))
        found.page.on("request", lambda request: found.requests.append(request.url))
        found.page.on("websocket", lambda socket: found.requests.append(socket.url))
        found.page.goto(address)
        found.settle()
        return found

    yield opened
    for context in contexts:
        context.close()


#: Loud noise and limits within the population, so that posteriors are wide and devices lie near limits.
NIGHT: dict[str, Any] = {
    "run": {"devices": 24, "seed": 5},
    "noise": {"sigma_v": 0.1},
    "gate": {"bias_fraction": 100.0, "theta_bias_max_deg": 90.0},
    "posterior": {"walkers": 24, "steps": 8, "rhat_max": 2.0, "ess_min": 10.0, "stored_draws": 60},
    "limits": {
        "f1_hz": {"min": 522.0, "max": 536.0},
        "split_hz": {"max": 4.0},
        "rate_bias_dps": {"min": -30.0, "max": 30.0},
    },
}


def made_night(results: Path, table: dict[str, Any]) -> Path:
    """A run of virtual devices with the configuration ``table``, made in this process; returns its folder."""
    config = converted(table, RunConfig, "run")
    count = config.run.devices
    store = create_run(results, "r", tomli_w.dumps(without_none(to_toml_table(config))), {"seed": config.run.seed})
    found = virtual_block(config, DeviceBlock(0, 0, count))
    store.commit_block(0, found.devices, found.posterior)
    store.finish("complete", {})
    return results / "run=r"


@pytest.fixture(scope="session")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 24 devices."""
    return made_night(tmp_path_factory.mktemp("night"), NIGHT)
