"""What the Tab key offers for values: names of the library, of stored runs and of files.

Each function returns the values that begin with ``incomplete``, sorted.  They list folders and import nothing, because a shell
waits for the answer at every Tab; a folder that cannot be read offers nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

SHELLS = ("bash", "zsh", "fish")
#: The variable by which their scripts ask for completions; typer finds it by the name of the program.
VARIABLE = "_GYROSCREEN_COMPLETE"
#: The installed packages: this file is workflows/commands/groups/complete.py.
_INSTALLED = Path(__file__).parents[3]
_EFFECTS = _INSTALLED / "pipeline" / "device" / "effects"
_IRREGULARITIES = _INSTALLED / "populations" / "irregularities"
_POPULATIONS = _INSTALLED / "populations" / "specs"
_RUN = "run="


def effects(incomplete: str) -> list[str]:
    """Names of the effects of the library."""
    return _beginning(incomplete, _modules(_EFFECTS))


def irregularities(incomplete: str) -> list[str]:
    """Names of the irregularities of the library."""
    return _beginning(incomplete, _modules(_IRREGULARITIES))


def populations(incomplete: str) -> list[str]:
    """Names of the shipped populations, and the TOML files in the folder that ``incomplete`` names.

    Where neither fits, the shell completes paths itself.
    """
    folder = incomplete[: incomplete.rfind("/") + 1]
    files = (f"{folder}{path.name}" for path in _toml_files(Path(folder or ".")))
    return _beginning(incomplete, [*(path.stem for path in _toml_files(_POPULATIONS)), *files])


def runs(ctx: Any, incomplete: str) -> list[str]:
    """Ids of the runs in the folder that --results or --out names, and "latest"."""
    return _beginning(incomplete, [*_runs(ctx), "latest"])


def runs_or_all(ctx: Any, incomplete: str) -> list[str]:
    """The same, and "all"."""
    return _beginning(incomplete, [*_runs(ctx), "latest", "all"])


def runs_or_last(ctx: Any, incomplete: str) -> list[str]:
    """Ids of runs, and the last ten."""
    return _beginning(incomplete, [*_runs(ctx), "last:10"])


def one_of(*values: str) -> Callable[[str], list[str]]:
    """A completion of fixed values."""

    def completed(incomplete: str) -> list[str]:
        return _beginning(incomplete, values)

    return completed


def _runs(ctx: Any) -> Iterator[str]:
    """Ids of runs.  The commands that have a --results keep their page in --out; `run` keeps its runs there."""
    folder = ctx.params.get("results") or ctx.params.get("out") or "results"
    return (path.name.removeprefix(_RUN) for path in _listed(Path(folder)) if path.name.startswith(_RUN))


def _modules(folder: Path) -> Iterator[str]:
    return (path.stem for path in _listed(folder) if path.suffix == ".py" and not path.name.startswith("_"))


def _toml_files(folder: Path) -> Iterator[Path]:
    return (path for path in _listed(folder) if path.suffix == ".toml")


def _listed(folder: Path) -> Iterable[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return ()


def _beginning(incomplete: str, values: Iterable[str]) -> list[str]:
    return sorted(value for value in values if value.startswith(incomplete))
