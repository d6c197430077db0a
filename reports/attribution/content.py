"""Where the loss of a run comes from: frozen content of the command and of the page.

Shares are shares of one of a variance, by irregularity and level; intervals are at ``reports.yields.LEVEL``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..interval_estimate import IntervalEstimate
from .reweighting import ChangedShare
from .shapley import Shares

#: The output that is the loss to all limits together, and the prefix of the loss to one of them.
LOSS = "loss"
#: Levels: of random numbers, of a random field on a wafer, and of the place of the die on it.
FIELD, PLACE = "field", "place"


@dataclass(frozen=True)
class Source:
    """An irregularity at one level; the place of the die on its wafer has the level ``PLACE``."""

    irregularity: str
    level: str


@dataclass(frozen=True)
class SourceShare:
    """The share of a source in the variance of an output.

    ``halved``: change of the mean of the output if the random numbers of the source were half as large; ``None`` where not known.
    """

    source: Source
    share: IntervalEstimate
    halved: IntervalEstimate | None = None


@dataclass(frozen=True)
class OutputShares:
    """The variance of an output by source, the largest share first.

    Parameters
    ----------
    output : ``LOSS`` (0 or 1, any limit), "loss:<quantity>" (that limit alone), or a quantity.
    mean : of the output; of a loss the share of lost devices.
    shares : by source.
    rest : what no source explains; ``None`` where they explain everything.
    """

    output: str
    mean: float
    shares: tuple[SourceShare, ...]
    rest: IntervalEstimate | None = None


@dataclass(frozen=True)
class StoredShares:
    """Shares from the stored devices alone; without outputs ``reason`` says why."""

    devices: int
    lots: int
    outputs: tuple[OutputShares, ...]
    reason: str = ""


@dataclass(frozen=True)
class Attribution:
    """Where the loss comes from.

    Parameters
    ----------
    samples : virtual devices that were exchanged number by number to find ``process``.
    process : shares of the population, by truth.
    verdicts : share of the variance of "not passed" that is that of the true loss; ``None`` where nothing or everything is lost.
    stored : shares from the stored devices; ``None`` where not asked for.
    """

    samples: int
    process: tuple[OutputShares, ...]
    verdicts: IntervalEstimate | None
    stored: StoredShares | None = None

    def loss(self) -> OutputShares:
        """The loss to all limits."""
        return self.process[0]


@dataclass(frozen=True)
class ChangedLoss:
    """A change of the population and what it does to the share of lost devices.

    Parameters
    ----------
    changes : parameter -> (value, new value).
    devices, lots : stored devices and their lots.
    truth : the stored devices drawn again under the changed population, by their true values.
    reweighted : by "truth" and "verdict", the stored devices weighted; ``None`` where refused.
    refusal : why; empty where not refused.
    """

    changes: Mapping[str, tuple[float, float]]
    devices: int
    lots: int
    truth: ChangedShare
    reweighted: Mapping[str, ChangedShare] | None
    refusal: str = ""


def output_shares(
    outputs: Sequence[str], sources: Sequence[Source], shares: Shares, rest: bool = False
) -> tuple[OutputShares, ...]:
    """The columns of ``shares`` as content; an output without variance has no shares.  ``rest``: its last row is the rest."""
    found = []
    for k, output in enumerate(outputs):
        rows = [
            IntervalEstimate(*(float(a[g, k]) for a in (shares.value, shares.sd, shares.low, shares.high)))
            for g in range(len(shares.value))
        ]
        known = all(math.isfinite(row.value) for row in rows)
        own = [SourceShare(source, row) for source, row in zip(sources, rows)] if known else []
        own.sort(key=lambda one: (-one.share.value, one.source.irregularity, one.source.level))
        found.append(OutputShares(output, float(shares.mean[k]), tuple(own), rows[-1] if rest and known else None))
    return tuple(found)


def with_halved(found: OutputShares, halved: Mapping[Source, IntervalEstimate]) -> OutputShares:
    """The shares with the change that halving each source would make."""
    return replace(found, shares=tuple(replace(one, halved=halved.get(one.source)) for one in found.shares))


def to_plain(value: Any) -> Any:
    """Plain data for JSON: numbers that are not finite are null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    return value
