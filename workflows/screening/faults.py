"""What happens to work whose worker ended: tried again, then divided down to the device, which is given up with its reason.

worker lost            once: again; twice: divided; a single device: lost
time limit exceeded    the device that exceeded it: lost; the others: again
exception              divided at once; a single device: lost
"""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

In = TypeVar("In")

#: Losses after which work is divided, and a single device given up.
LOSSES = 2
#: Work that had not started when its worker ended did not end it; a sign of life may have been lost with the worker, though.
_UNSTARTED = 3


@dataclass(frozen=True)
class Faults(Generic[In]):
    """How work is divided and given up.

    Parameters
    ----------
    devices : numbers of the devices of an item.
    part : the part of an item with these devices.
    lost : the item, marked as given up for a reason; its task then only states this.
    """

    devices: Callable[[In], range]
    part: Callable[[In, range], In]
    lost: Callable[[In, str], In]

    def parts(self, item: In, suspect: int | None) -> list[In]:
        """The item in parts: those before and after the suspected device and the device alone; halves if none is suspected."""
        whole = self.devices(item)
        middle = (whole.start + whole.stop) // 2
        cuts = (middle, middle) if suspect is None or suspect not in whole else (suspect, suspect + 1)
        spans = (range(whole.start, cuts[0]), range(*cuts), range(cuts[1], whole.stop))
        return [self.part(item, span) for span in spans if span]

    def single(self, item: In) -> bool:
        """Whether the item is a single device."""
        return len(self.devices(item)) == 1


@dataclass(frozen=True)
class Sign:
    """A device that started in a worker for the task ``key``: its number, its limit [s], and when it started (monotonic) [s]."""

    key: str
    device: int
    limit_s: float
    since: float

    def over(self, now: float) -> float | None:
        """How long the device has run [s] at the time ``now``, if that is its limit."""
        return now - self.since if now - self.since >= self.limit_s - 0.5 else None


@dataclass(frozen=True)
class Ending:
    """How a worker ended: ``why``, if that is known, and whether that is certain, so that the time of the device says nothing."""

    why: str = ""
    certain: bool = False


@dataclass(frozen=True)
class Try(Generic[In]):
    """An item to work on, and how often its worker was lost while it ran, and before it ran."""

    item: In
    losses: int = 0
    unstarted: int = 0


@dataclass
class TimeLimit:
    """The time limit of a device [s]: given, or ``FACTOR`` times the median duration, at least ``LEAST_S``."""

    given_s: float | None = None
    seconds: deque[float] = field(default_factory=lambda: deque(maxlen=1000))

    FACTOR, LEAST_S, UNKNOWN_S = 20.0, 60.0, 600.0

    @property
    def now_s(self) -> float:
        """The limit of the next device."""
        if self.given_s is not None:
            return self.given_s
        return max(self.LEAST_S, self.FACTOR * statistics.median(self.seconds)) if self.seconds else self.UNKNOWN_S


def after_loss(tried: Try[In], sign: Sign | None, at: float, ending: Ending, faults: Faults[In]) -> list[Try[In]]:
    """What to do with an item whose worker ended while it was there.

    ``sign`` is the last sign of life, ``at`` the time of the loss (monotonic, as that of the sign).
    """
    if sign is None and tried.unstarted < _UNSTARTED:
        return [replace(tried, unstarted=tried.unstarted + 1)]
    suspect = None if sign is None else sign.device
    ran = None if sign is None or ending.certain else sign.over(at)
    if ran is not None:
        reason = f"no result after {ran:.0f} s, the time limit of a device; its worker was ended"
        parts = faults.parts(tried.item, suspect)
        return [Try(faults.lost(part, reason) if suspect in faults.devices(part) else part) for part in parts]
    if tried.losses + 1 < LOSSES:
        return [replace(tried, losses=tried.losses + 1, unstarted=0)]
    if not faults.single(tried.item):
        # A part is divided again at its next loss; a device is only given up after as many losses as a block.
        parts = faults.parts(tried.item, suspect)
        return [Try(part, 0 if faults.single(part) else LOSSES - 1) for part in parts]
    reason = (
        f"its worker ended {LOSSES} times while it ran: {ending.why or 'a crash, or more memory than a worker may use'}"
    )
    return [Try(faults.lost(tried.item, reason))]


def after_exception(tried: Try[In], error: BaseException, faults: Faults[In]) -> list[Try[In]]:
    """What to do with an item whose task raised an exception that is not about its input."""
    if not faults.single(tried.item):
        return [Try(part) for part in faults.parts(tried.item, None)]
    return [Try(faults.lost(tried.item, f"internal error: {type(error).__name__}: {error}"[:300]))]
