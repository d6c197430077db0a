"""Effects that add a mode may act several times in one model: ``parasitic_mode``, ``parasitic_mode_2``, and so on."""

from __future__ import annotations

from collections.abc import Mapping

from .effect import Effect, numbered

#: Most modes that one effect may add to a model, each by a rung of its own.
MOST_MODES = 6


def with_more_modes(found: Mapping[str, Effect]) -> dict[str, Effect]:
    """All of ``found`` by name, sorted, and each that adds a mode up to ``MOST_MODES`` times."""
    modes = [effect for effect in found.values() if effect.mode is not None]
    more = {f"{one.name}_{k}": numbered(one, k) for one in modes for k in range(2, MOST_MODES + 1)}
    return dict(sorted({**more, **found}.items()))
