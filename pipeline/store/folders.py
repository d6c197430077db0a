"""Where runs lie: ``run=<id>`` folders in a results folder.  It imports no table library, so that commands can ask at once."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import UsageError
from .manifest import NAME as MANIFEST

PREFIX = "run="
#: "s3:" of s3://bucket; one letter is a drive of Windows.
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:$")


def check_results(results: Path) -> None:
    """Check that ``results`` can be a folder: a URL would make folders of that name.

    Raises
    ------
    UsageError : it is a URL.
    """
    if _URL.match(results.parts[0] if results.parts else ""):
        raise UsageError(
            "results are kept in a folder, not at a URL: commits need renames and locks, which object storage lacks",
            value=str(results),
            allowed="a folder of a file system",
            next_step="run in a folder and copy the finished run (docs/how-to/cluster.md)",
        )


def run_folders(results: Path) -> tuple[Path, ...]:
    """Folders of runs (``run=<id>`` with a manifest), by name; anything else in the results folder is no run.

    Nor is a link: what it leads to lies elsewhere, and would be changed from here.
    """
    check_results(results)
    if not results.is_dir():
        return ()
    return tuple(
        sorted(
            path
            for path in results.iterdir()
            if path.name.startswith(PREFIX) and not path.is_symlink() and (path / MANIFEST).exists()
        )
    )
