"""The effects that a model may have: those of the package and of the user's folders; modes, several times."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from .effect import Effect, find_effects
from .exact_null import with_exact_nulls
from .several_modes import with_more_modes
from .tried_out import with_working_stages


def available_effects(folders: Sequence[str] = ()) -> dict[str, Effect]:
    """All effects by name, sorted.

    Raises
    ------
    ConfigError : as in ``find_effects``, or an effect of the user fails, or its null is not exactly "no effect".
    """
    return _with(folders) if folders else dict(_of_package())


@cache
def _of_package() -> dict[str, Effect]:
    # A screening examines tens of models a device, and the files of the package do not change meanwhile; a user's may.
    return _with(())


def _with(folders: Sequence[str]) -> dict[str, Effect]:
    found = find_effects(tuple(Path(folder) for folder in folders))
    return with_more_modes(with_exact_nulls(with_working_stages(found)))
