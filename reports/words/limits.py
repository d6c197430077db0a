"""Sentences about limits: where they came from."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..limits_origin import LimitsOrigin


def origin_sentence(origin: LimitsOrigin) -> str:
    """Where the limits came from, with the hash of the file as it was then."""
    digest = f" (sha256 {origin.sha256[:12]})" if origin.sha256 else ""
    if origin.kind == "shipped default":
        return f"The limits are the shipped default, {origin.file}{digest}: the configuration of the run states none."
    if origin.kind == "command line":
        return f"{given_limits(origin).removesuffix('.')}, not those by which the run was judged."
    if not origin.file:
        return "The limits are those in the configuration of the run; the file that it was read from is not recorded."
    return f"The limits are those in [limits] of {origin.file}{digest}."


def given_limits(origin: LimitsOrigin) -> str:
    """The limits that a command was given for a device or a lot."""
    return f"The limits are those of --limits {origin.file} (sha256 {origin.sha256[:12]})."


def origin_words(origin: LimitsOrigin) -> str:
    """The same in a few words, for a terminal."""
    return origin.kind if not origin.file else f"{origin.kind}, {origin.file}"
