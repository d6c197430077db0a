"""gyroscreen explore."""

from __future__ import annotations

import asyncio
import importlib.util
import threading
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import ConfigError

if TYPE_CHECKING:
    from ..explore.choose import Kind, Start


@dataclass(frozen=True)
class Given:
    """Files that the page starts from: model and folders of effects of a campaign, population and limits of a lot."""

    model: Path | None = None
    effects: tuple[Path, ...] = ()
    population: Path | None = None
    limits: Path | None = None


def explore(path: Path | None, results: Path, port: int, browser: bool, given: Given = Given()) -> None:
    """See ``gyroscreen explore --help``."""
    if importlib.util.find_spec("bokeh") is None:
        raise ConfigError(
            "interactive pages need the package bokeh, which is not installed",
            next_step='pip install "gyroscreen[explore]"',
        )
    from ..explore.choose import kind_of, view_of
    from ..explore.server import serve

    kind, shown = kind_of(path, results)
    view = view_of(*_start("lot" if given.population is not None else kind, shown, given))

    def ready(address: str) -> None:
        print(address, flush=True)
        if browser:
            # Finding a browser may take seconds, in which the page would not be served.
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    asyncio.run(serve(view, port, ready))


def _start(kind: Kind, path: Path, given: Given) -> tuple[Kind, Path, Start]:
    """The kind, the path, and what the given files hold.

    Raises
    ------
    UsageError : a file that does not belong to this kind.
    ConfigError : a file cannot be read.
    """
    from reports.limits import DEFAULT_LIMITS, load_limits

    from ..explore.choose import Start
    from .groups.options import only_with
    from .learn import start_model
    from .lot import start_population

    if kind != "campaign":
        only_with("a campaign", {"--model": given.model, "--effects": given.effects})
    if kind != "lot":
        only_with("a lot", {"--population": given.population, "--limits": given.limits})
    judged = DEFAULT_LIMITS if given.limits is None else load_limits(given.limits)
    return kind, path, Start(start_model(given.model, given.effects), start_population(given.population), judged)
