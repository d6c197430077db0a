"""What devices with the same drive share is kept for the next ones, unless the record is long.

A worker would otherwise hold parts of records that never come again: with records of 100 MB, 1 GB after four devices.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Concatenate, ParamSpec, TypeVar, cast

from .inband import SHORT, Band

P = ParamSpec("P")
T = TypeVar("T")


def kept_if_short(most: int) -> Callable[[Callable[Concatenate[Band, P], T]], Callable[Concatenate[Band, P], T]]:
    """A function of a band whose last ``most`` results are kept, those of long records excepted."""

    def decorate(function: Callable[Concatenate[Band, P], T]) -> Callable[Concatenate[Band, P], T]:
        kept = cast(Callable[Concatenate[Band, P], T], lru_cache(most)(function))

        @wraps(function)
        def chosen(band: Band, /, *more: P.args, **named: P.kwargs) -> T:
            return (kept if band.samples <= SHORT else function)(band, *more, **named)

        return chosen

    return decorate
