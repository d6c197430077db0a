"""Where the sources of the manual are, and where it is built.

The sources are the folder docs/ beside the packages, or the copy that a wheel holds in workflows/manual/sources. The manual
is built in the user's cache folder, by version and content of the sources and of the code that it describes, never beside
the packages.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from hashlib import sha256
from importlib import metadata
from pathlib import Path

from pipeline.errors import UsageError

_HERE = Path(__file__).parent
_PACKAGES = ("pipeline", "populations", "reports", "workflows")
#: Files outside of docs/ that pages include.
_BESIDE = ("CHANGELOG.md", "CITATION.cff")
_CODE = (".py", ".toml")


@dataclass(frozen=True)
class ManualSources:
    """Root that contains docs/ and the files that its pages include, and the root of the packages."""

    root: Path
    packages: Path

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that the build copies, sorted."""
        pages = (path for path in (self.root / "docs").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
        return (*sorted(pages), *(self.root / name for name in _BESIDE))

    def digest(self) -> str:
        """Digest of the sources and of the code that generated pages describe."""
        own = set(self.files)
        code = (path for name in _PACKAGES for path in (self.packages / name).rglob("*") if path.suffix in _CODE)
        found = sha256()
        for root, paths in ((self.root, own), (self.packages, set(code) - own)):
            for path in sorted(paths):
                found.update(f"{path.relative_to(root).as_posix()}\0".encode())
                found.update(path.read_bytes())
        return found.hexdigest()[:16]


def find_sources() -> ManualSources:
    """The sources of this installation.

    Raises
    ------
    UsageError : the installation has none.
    """
    packages = _HERE.parents[1]
    for root in (_HERE / "sources", packages):
        # Another project's docs/ may lie beside installed packages.
        if (root / "docs" / "conf.py").exists() and all((root / name).exists() for name in _BESIDE):
            return ManualSources(root, packages)
    raise UsageError(
        "this installation does not contain the sources of the manual",
        value=str(packages),
        allowed="an installation from the project's folder or from its wheel",
        next_step="install gyroscreen again from the project's folder: pip install .",
    )


def cache_folder() -> Path:
    """Folder of the user for what can be computed again, as the system names it."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "gyroscreen" / "manual"


def built_folder(sources: ManualSources, notebooks: bool = True) -> Path:
    """Folder of the manual of these sources, with or without executed notebooks, whether or not it is built yet."""
    plain = "" if notebooks else "-plain"
    return cache_folder() / f"{metadata.version('gyroscreen')}-{sources.digest()}{plain}"
