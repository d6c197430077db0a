"""The answers about where a lot comes from: frozen data, without the code that finds them."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from ...errors import IntegrityError
from ..answers import Answer, to_builtins

#: The page of a run's folder that holds them.
FILE = "lot_origin.json"


class DepartureAnswer(Answer, frozen=True, eq=False):
    """A number that differs: see :class:`.departures.Departure`; ``quantity`` and ``pattern`` where it has one."""

    part: str
    kind: str
    quantity: str | None
    pattern: str | None
    level: str
    stated: float
    estimate: float | None
    low: float | None
    high: float | None
    p_value: float


class OriginAnswer(Answer, frozen=True, eq=False):
    """Whether a lot comes from a population.

    ``verdict`` : "from_population", "departs" or "undecided" (``reason`` says why).
    ``p_value`` : probability that a lot of the population departs as far in any number; ``false_alarm`` is where it departs.
    ``departures`` : the numbers that differ, the least probable first.
    ``smallest_shift`` : quantity -> shift of the mean that such a lot shows in 9 of 10 cases [sd of a device].
    """

    population: str
    devices: int
    verdict: str
    p_value: float | None
    false_alarm: float
    departures: tuple[DepartureAnswer, ...] = ()
    smallest_shift: Mapping[str, float] = {}
    reason: str | None = None


class DriftAnswer(Answer, frozen=True, eq=False):
    """Whether a lot differs from those of earlier nights: "no_drift", "drifted" or "undecided"; otherwise as OriginAnswer."""

    nights: tuple[str, ...]
    devices: int
    earlier_devices: int
    verdict: str
    p_value: float | None
    false_alarm: float
    departures: tuple[DepartureAnswer, ...] = ()
    smallest_shift: Mapping[str, float] = {}
    reason: str | None = None


class LotOriginAnswers(Answer, frozen=True, eq=False):
    """Both answers of a night."""

    origin: OriginAnswer
    drift: DriftAnswer

    def to_json(self) -> bytes:
        """As the bytes of ``lot_origin.json``."""
        return msgspec.json.format(msgspec.json.encode(to_builtins(self)), indent=1) + b"\n"

    @staticmethod
    def from_json(data: bytes) -> LotOriginAnswers:
        """Inverse of :meth:`to_json`; IntegrityError where the bytes are not its own."""
        try:
            return msgspec.json.decode(data, type=LotOriginAnswers)
        except msgspec.MsgspecError as error:
            raise IntegrityError(f"{FILE} is incomplete ({error})", next_step="run again") from None
