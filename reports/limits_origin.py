"""Where the limits that judged a run came from: a file, the shipped default, or the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from pipeline.store.files import file_sha256

from .limits import DEFAULT_FILE

Origin = Literal["shipped default", "file", "command line"]


@dataclass(frozen=True)
class LimitsOrigin:
    """``kind``; the file that states the limits, "" where it is not known; and its SHA-256 when it was read, "" likewise."""

    kind: Origin
    file: str = ""
    sha256: str = ""

    def to_dict(self) -> dict[str, str]:
        """For JSON and for the manifest: {"from", "file", "sha256"}."""
        plain = asdict(self)
        return {"from": plain.pop("kind"), **plain}


def shipped_origin() -> LimitsOrigin:
    """The shipped default."""
    return LimitsOrigin("shipped default", DEFAULT_FILE.name, file_sha256(DEFAULT_FILE)[0])


def origin_of_file(path: Path, kind: Origin = "file") -> LimitsOrigin:
    """A file of the user: a configuration of a run with [limits], or a limits file."""
    return LimitsOrigin(kind, str(path.absolute()), file_sha256(path)[0])


def recorded_origin(provenance: Mapping[str, Any], stated: bool) -> LimitsOrigin:
    """The origin that a run recorded; else what its configuration shows: ``stated`` limits, or the shipped default."""
    found = provenance.get("limits")
    if isinstance(found, Mapping) and found.get("from") in get_args(Origin):
        return LimitsOrigin(found["from"], str(found.get("file", "")), str(found.get("sha256", "")))
    return LimitsOrigin("file") if stated else shipped_origin()
