"""gyroscreen explore."""

from __future__ import annotations

import asyncio
import importlib.util
import webbrowser
from pathlib import Path

from pipeline.errors import ConfigError


def explore(path: Path | None, results: Path, port: int, browser: bool) -> None:
    """See ``gyroscreen explore --help``."""
    if importlib.util.find_spec("bokeh") is None:
        raise ConfigError(
            "interactive pages need the package bokeh, which is not installed",
            next_step='pip install "gyroscreen[explore]"',
        )
    from ..explore.choose import kind_of, view_of
    from ..explore.server import serve

    view = view_of(*kind_of(path, results))

    def ready(address: str) -> None:
        print(address, flush=True)
        if browser:
            webbrowser.open(address)

    asyncio.run(serve(view, port, ready))
