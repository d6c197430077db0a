"""Detect a file or folder of the user that hides a package of gyroscreen.

Python looks for imports in the working folder first (``python -c``, ``python -m``, notebooks), and the packages have generic
names.
Nothing here may import them.

A ``workflows.py`` of the user is imported in place of this package, so nothing here can run: Python then states that it is
no package.  The ``gyroscreen`` command and its workers do not look into the working folder.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

_NAMES = ("pipeline", "populations", "reports")


def check_packages(names: tuple[str, ...] = _NAMES) -> None:
    """Raise ImportError, in one line, where something else than gyroscreen's own package would be imported."""
    here = Path(__file__).resolve().parents[1]
    for name in names:
        try:
            spec = importlib.util.find_spec(name)
        except ValueError:  # a module without a spec, such as one that a notebook made
            spec = None
        origin = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        if origin == here / name / "__init__.py":
            continue
        found = origin or next(iter((spec and spec.submodule_search_locations) or ["a module in memory"]))
        raise ImportError(
            f"{found} hides the package {name!r} of gyroscreen; rename it, or start Python in another folder"
        ) from None
