"""gyroscreen population."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import ConfigError, UsageError, unwritable
from populations.describe import described
from populations.edit import added, dropped
from populations.extend import file_of
from populations.spec import load_spec


def show(name: str) -> None:
    """See ``gyroscreen population show --help``."""
    print(described(load_spec(file_of(name, Path()))), end="")


def change(name: str, path: Path, add: bool) -> None:
    """Add or drop an irregularity; ``add`` creates the file."""
    if path.suffix != ".toml":
        raise UsageError(
            "not the name of a population file",
            value=str(path),
            allowed="a name that ends in .toml",
            next_step="correct it",
        )
    text = _text(path)
    if text is None and not add:
        raise ConfigError(
            "no such population file", value=str(path), next_step="create it: gyroscreen population add NAME FILE.toml"
        )
    changed = added(name, path, text) if text is None or add else dropped(name, path, text)
    try:
        path.write_text(changed, encoding="utf-8")
    except OSError as error:
        raise unwritable("the population file", path, error) from None
    print(f"{path}: irregularities: {', '.join(sorted(load_spec(path).irregularity))}")


def _text(path: Path) -> str | None:
    """The content of the file; ``None`` if there is none."""
    if not path.exists():
        return None
    load_spec(path)  # every fault of the file as one message
    return path.read_text(encoding="utf-8")
