"""Timing of a part, a peer or a primitive by pytest-benchmark, in rounds that alternate with the reference loop.

The timer is processor time.  A round of the work follows a round of the reference loop, and the ratio is the median over these
pairs: both see the same load and clock.  The ratio of the least times is not as steady, because one lucky round of the reference
loop decides it (noise and ADC: 3.1 instead of 2.1 to 2.3 in one of seven runs, while 15 processes waited for two cores).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .primitives import reference

#: Processor time spent on one entry [s], without the reference loop.
SECONDS = 1.5
#: Bounds of its number of rounds.
_LEAST, _MOST = 5, 300


@dataclass(frozen=True, eq=False)
class Timed:
    """What a benchmark calls: :meth:`part`, :meth:`peer` or :meth:`primitive`; each runs ``work`` and returns what it gave.

    ``seconds`` is the processor time for an entry.
    """

    benchmark: Any
    seconds: float

    def part(
        self,
        name: str,
        work: Callable[[], Any],
        limit: Mapping[str, float],
        formula: str,
        inside: str = "device",
        devices: int = 1,
    ) -> Any:
        """A part of a device.

        Parameters
        ----------
        name, work : the part; ``work`` treats ``devices`` devices.
        limit : primitive -> count per device; ``formula`` says where the counts come from.
        inside : the part that contains it, or "" for the device itself.
        """
        info = {"role": "part", "limit": dict(limit), "formula": formula, "inside": inside, "devices": devices}
        return self._run(name, work, info)

    def peer(self, of: str, name: str, work: Callable[[], Any], times: float = 1.0, note: str = "") -> Any:
        """A peer of part ``of``; one run of ``work`` is 1 / ``times`` of the task, as ``note`` explains."""
        return self._run(name, work, {"role": "peer", "of": of, "times": times, "note": note})

    def primitive(self, name: str, work: Callable[[], Any], count: float) -> Any:
        """A primitive of ``count`` units."""
        return self._run(name, work, {"role": "primitive", "count": count})

    def _run(self, name: str, work: Callable[[], Any], info: Mapping[str, Any]) -> Any:
        work()  # compiles
        started = time.process_time()
        answer = work()
        once = time.process_time() - started
        # A peer of seconds is run once more: its ratio needs no third digit.
        least = 1 if once > self.seconds else _LEAST
        rounds = min(max(least, int(self.seconds / max(once, 1e-5))), _MOST)
        references: list[float] = []

        def before() -> None:
            begun = time.process_time()
            reference()
            references.append(time.process_time() - begun)

        self.benchmark.extra_info.update(info, name=name)
        self.benchmark.pedantic(work, setup=before, rounds=rounds)
        own = np.array(self.benchmark.stats.stats.data)
        self.benchmark.extra_info["ratio"] = float(np.median(own / np.array(references[-own.size :])))
        return answer
