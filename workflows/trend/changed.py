"""What changed between two runs: limits, population, the rest of the configuration, the user's files, versions, machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pipeline.store.manifest import Manifest
from reports.trend.content import InputChange

from ..config import RunConfig
from ..screening.inputs import Inputs, changed_keys

#: Tables of a configuration whose differences are no change of the product, of its test, or of its judgement.
_IGNORED = ("run.", "trend.", "targets.")
_GROUPS = {
    "limits": "limits",
    "rule": "limits",
    "population": "population",
    "source": "population",
    "experiment": "experiment",
}
_SHOWN = 80


def changes(
    before: tuple[Manifest, RunConfig, Inputs | None], after: tuple[Manifest, RunConfig, Inputs | None]
) -> tuple[InputChange, ...]:
    """All changes from one run to a later one, limits first, then population, experiment, other keys, files and versions."""
    order = ("limits", "population", "experiment", "configuration", "file", "version")
    found = [
        *_keys(before[1], after[1]),
        *_files(before[2], after[2]),
        *_versions(before[0].provenance, after[0].provenance),
    ]
    return tuple(sorted(found, key=lambda one: order.index(one.what)))


def _keys(before: RunConfig, after: RunConfig) -> Iterator[InputChange]:
    for key, old, new in changed_keys(before, after):
        if key == "run.devices" or key == "run.seed" or not key.startswith(_IGNORED):
            group = _GROUPS.get(key.partition(".")[0], "configuration")
            yield InputChange(group, key, _shown(old), _shown(new))


def _files(before: Inputs | None, after: Inputs | None) -> Iterator[InputChange]:
    """Files of code and populations by name: a file that moved has not changed."""
    old, new = ({} if one is None else _hashes(one) for one in (before, after))
    for name in sorted(old.keys() | new.keys()):
        if old.get(name) != new.get(name):
            yield InputChange("file", name, _digest(old.get(name)), _digest(new.get(name)))


def _hashes(inputs: Inputs) -> dict[str, str]:
    return {
        f"{one.what} {Path(one.path).name}": one.sha256 for one in inputs.of("population", "irregularity", "effect")
    }


def _digest(sha256: str | None) -> str:
    return "–" if sha256 is None else f"sha256 {sha256[:12]}"


def _versions(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[InputChange]:
    old, new = (_flat(one) for one in (before, after))
    for name in sorted(old.keys() | new.keys()):
        if old.get(name) != new.get(name):
            yield InputChange("version", name, _shown(old.get(name)), _shown(new.get(name)))


def _flat(provenance: Mapping[str, Any]) -> dict[str, object]:
    versions = provenance.get("versions")
    whole = {str(name): value for name, value in versions.items()} if isinstance(versions, Mapping) else {}
    for name in ("python", "git_revision", "git_modified", "simd"):
        whole[name] = provenance.get(name)
    return whole


def _shown(value: object) -> str:
    if value is None:
        return "–"
    text = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"
