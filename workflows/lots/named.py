"""Whether a path names a lot.  The commands of a device ask it first, so it imports nothing that only lots need."""

from __future__ import annotations

from pathlib import Path

from pipeline.store.folders import run_folders
from pipeline.store.manifest import NAME as MANIFEST


def is_lot(path: Path) -> bool:
    """Whether ``path`` names a lot rather than the measurement of one device."""
    if path.is_dir():
        return (path / "lot.toml").is_file() or (path / MANIFEST).is_file() or bool(run_folders(path))
    return path.name == "lot.toml" or (path.suffix == ".toml" and path.is_file() and _names_a_table(path))


def _names_a_table(path: Path) -> bool:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return any(line.partition("=")[0].strip() == "file" for line in text.splitlines()) and "[[record]]" not in text
