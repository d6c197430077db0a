"""Properties that an effect declares about itself: other effects that look like it, and its plausible sizes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, eq=False)
class LookAlike:
    """Other effects that together reproduce the records of an effect.

    Parameters
    ----------
    effects : names of the other effects.
    example : parameter -> value of the imitated effect; there the others explain all but 1e-4 of its delta_chi2 (tested).
    always : the others imitate the effect at every value of its parameters, not only near the example.
    start : full parameter name -> value at which a fit of the others starts, if not at their null.
    """

    effects: tuple[str, ...]
    example: Mapping[str, float]
    always: bool = False
    start: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SizeRange:
    """Plausible sizes of an effect, for studies that draw them.

    Parameters
    ----------
    typical : norm of the parameters without a grid; about SNR 100 on the standard campaign (a factor of 10 does not matter).
    largest : largest plausible magnitude of a parameter; may be a function of the plant's parameters by name.
    signed : both signs are plausible.
    """

    typical: float
    largest: float | Callable[[Mapping[str, float]], float]
    signed: bool = True
