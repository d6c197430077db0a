"""Provenance of results: seed, versions, platform.

Same seed, same versions, same SIMD tier: the same bits.  Another SIMD tier: 1e-12 relative, because
numpy's transcendentals differ between tiers.
"""

from __future__ import annotations

import platform
import re
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

DISTRIBUTION = "gyroscreen"


def provenance(seed: int, **more: Any) -> dict[str, Any]:
    """Provenance of a run, ready for JSON.

    Parameters
    ----------
    seed : root of all random streams.
    more : further entries.

    Returns
    -------
    seed, versions (distribution -> version), python, git_revision (null outside a checkout), git_modified,
    platform, simd.
    """
    revision, modified = _git(Path(__file__).resolve().parents[2])
    return {
        "seed": seed,
        "versions": package_versions(),
        "python": platform.python_version(),
        "git_revision": revision,
        "git_modified": modified,
        "platform": {
            "system": platform.system(),
            "machine": platform.machine(),
            "libc": "-".join(platform.libc_ver()),
        },
        "simd": simd_tier(),
        **more,
    }


def package_versions() -> dict[str, str]:
    """Versions of this distribution and of its run-time dependencies; empty if it is not installed."""
    try:
        required = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return {}
    names = [re.split(r"[^A-Za-z0-9._-]", line)[0] for line in required if "extra ==" not in line]
    versions = {DISTRIBUTION: metadata.version(DISTRIBUTION)}
    for name in sorted(names):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions


def simd_tier() -> list[str]:
    """SIMD extensions that numpy dispatches to on this processor, in numpy's names; empty if numpy does not say."""
    config: Any = np.show_config(mode="dicts")
    try:
        found = config["SIMD Extensions"]
        return [str(name) for part in ("baseline", "found") for name in found.get(part, [])]
    except (KeyError, TypeError, AttributeError):  # numpy does not document the layout of this table.
        return []


def _git(root: Path) -> tuple[str | None, bool | None]:
    """Revision of the checkout whose top is ``root``, and whether its files differ from it; (None, None)
    if there is none.

    An installed copy may lie inside another project's checkout (a venv in a project), so only a checkout
    that tracks this package counts.
    """
    try:
        _run_git(root, "ls-files", "--error-unmatch", "pipeline/__init__.py")
        return _run_git(root, "rev-parse", "HEAD"), bool(_run_git(root, "status", "--porcelain"))
    except (OSError, subprocess.SubprocessError):
        return None, None


def _run_git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()
