"""What physics a run contains, in sentences for the head of its page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .campaign import effect_words, effects_listed


@dataclass(frozen=True)
class RunPhysics:
    """The physics of a run.

    Parameters
    ----------
    carried : effects of the virtual devices; empty for measured devices.
    left_out : effects whose sizes the population draws, but which the virtual devices do not have.
    noise : kind of the simulated noise; empty for measured devices.
    mismatch : whether the fitted model has electrode mismatches.
    """

    carried: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    noise: str = ""
    mismatch: bool = False


def physics_sentences(physics: RunPhysics) -> tuple[str, ...]:
    """What the devices carry, what was fitted, and what was left out; one sentence each."""
    out = []
    if physics.carried:
        noise = {
            "ar": "autoregressive noise",
            "jitter": "white noise and sampling jitter",
            "gain": "white noise and gain noise",
        }
        out.append(
            f"The virtual devices carry {_named(physics.carried)}, and {noise.get(physics.noise, f'{physics.noise} noise')}."
        )
    mismatch = " and the electrode mismatches, which contain an up-down tilt" if physics.mismatch else ""
    out.append(f"The fitted model has off-diagonal damping{mismatch}.")
    if physics.left_out:
        out.append(f"Drawn by the population but not simulated: {effects_listed(physics.left_out)}.")
    return tuple(out)


def _named(names: Sequence[str]) -> str:
    return ", ".join(effect_words(name) for name in names)
