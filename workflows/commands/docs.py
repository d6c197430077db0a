"""gyroscreen docs."""

from __future__ import annotations

import shutil
import sys
import webbrowser
from pathlib import Path
from typing import Any

from reports.words.manual import BUILDING

from ..manual.build import build, check
from ..manual.pages import generated_pages
from ..manual.sources import built_folder, find_sources

#: Builds that stay in the cache: those of other installations of the same user.
_KEPT = 3


def docs(command_line: Any, out: Path | None, *, opens: bool, notebooks: bool, strict: bool) -> None:
    """See ``gyroscreen docs --help``; ``command_line`` is the group of all commands."""
    sources = find_sources()
    folder = out or built_folder(sources, notebooks)
    page = folder / "index.html"
    if out is not None or strict or not page.exists():
        check(folder)
        print(BUILDING, file=sys.stderr)
        page = build(sources, generated_pages(command_line), folder, strict=strict, notebooks=notebooks)
        if out is None:
            _forget_old(folder)
    print(page)
    if opens:
        webbrowser.open(page.absolute().as_uri())


def _forget_old(folder: Path) -> None:
    """Remove the oldest builds beside ``folder``."""
    built = sorted(folder.parent.glob("*/index.html"), key=lambda page: page.stat().st_mtime, reverse=True)
    for page in built[_KEPT:]:
        shutil.rmtree(page.parent, ignore_errors=True)
