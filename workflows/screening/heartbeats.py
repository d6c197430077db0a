"""How long each worker has been silent: the time in which somebody looked and its last heartbeat stayed the same.

Time in which nobody looked does not count: a driver that was suspended (Ctrl-Z, SIGSTOP, sleep of the machine) would take every
worker for silent when it goes on, before the first heartbeat reaches it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

#: Time between two looks that counts at most [s]: looks come every 2 s, or after the commit that is under way.
_MOST_S = 5.0


@dataclass
class Heartbeats:
    """Last heartbeat of each worker, by address, and how long it has been the last one [s]."""

    last: dict[str, tuple[float, float]] = field(default_factory=dict)
    looked: float = field(default_factory=time.monotonic)

    def look(self, seen: Mapping[str, float], now: float) -> None:
        """Take over the last heartbeats ``seen`` at the time ``now`` (monotonic) [s]."""
        passed = min(now - self.looked, _MOST_S)
        self.looked = now
        self.last = {
            address: (
                at,
                self.last[address][1] + passed if address in self.last and self.last[address][0] == at else 0.0,
            )
            for address, at in seen.items()
        }

    def silent(self, longer_s: float) -> list[str]:
        """Addresses of the workers that have been silent for longer than ``longer_s``."""
        return [address for address, (_, silence) in self.last.items() if silence > longer_s]
