"""Which effects a lot needs beside the screening model, and the yield without and with them.

The findings come from the run (``lot_effects.json`` beside its tables); the yields are counted from the devices table: a device
that was refitted with the lot's effects in its model has the verdict of that fit, all others keep theirs.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass

import msgspec
import numpy as np

from pipeline.errors import IntegrityError
from pipeline.plain import plain

from ..coded import paired
from ..devices import Devices
from ..yields import Yield, yield_of_verdicts

FILE = "lot_effects.json"
_MOST_LISTED = 40


@dataclass(frozen=True)
class ParameterSize:
    """Size of a parameter, in its unit, among devices that have the effect: mean with sd, and sd between devices."""

    name: str
    unit: str
    mean: float | None
    mean_sd: float | None
    spread: float | None


@dataclass(frozen=True)
class LotEffect:
    """An effect that a lot needs.

    Parameters
    ----------
    effect, rivals : its name, and effects that these records cannot distinguish from it.
    lot : the lot that needs it; "" is the whole run.
    lots : for the whole run, the lots that have it if other lots demonstrably lack it; else empty.
    share, low, high : share of devices that have it, with its 95 % interval.
    sizes : of its parameters.
    log_p, log_p_without : log p of all devices together, and without the 10 % of devices with the strongest evidence.
    devices : number of devices with scores.
    """

    effect: str
    rivals: tuple[str, ...]
    lot: str
    lots: tuple[str, ...]
    share: float | None
    low: float
    high: float
    sizes: tuple[ParameterSize, ...]
    log_p: float
    log_p_without: float
    devices: int


@dataclass(frozen=True)
class LotEffects:
    """Result of the examination of a run's misfits.

    Parameters
    ----------
    alpha : family-wise probability of naming an effect where there is none.
    flagged, examined : misfits, and how many of them were examined.
    sampled, ok : devices with status ok that were examined, of how many.
    refitted : devices refitted with the effects.
    effects : that the lots need.
    nearest, log_p_nearest : the most significant of the other effects, and its family-wise log p.
    """

    alpha: float
    flagged: int
    examined: int
    sampled: int
    ok: int
    refitted: int
    effects: tuple[LotEffect, ...]
    nearest: str
    log_p_nearest: float

    def to_json(self) -> bytes:
        """As the bytes of ``lot_effects.json``."""
        return msgspec.json.format(msgspec.json.encode(plain(asdict(self))), indent=1) + b"\n"

    @staticmethod
    def from_json(data: bytes) -> LotEffects:
        """Inverse of :meth:`to_json`.

        Raises
        ------
        IntegrityError : the bytes do not come from ``to_json``.
        """
        try:
            return msgspec.json.decode(data, type=LotEffects)
        except msgspec.MsgspecError as error:
            raise IntegrityError(f"{FILE} is incomplete ({error})", next_step="run again") from None


@dataclass(frozen=True)
class Misfit:
    """A misfit that the lot's effects do not explain: what it lacks by itself, and the reason."""

    device_id: str
    lot: str
    missing: str
    sizes: str
    reason: str


@dataclass(frozen=True)
class NeededEffects:
    """The section of the page: findings, yields, what single devices lack, and unexplained misfits."""

    found: LotEffects
    without: Yield
    with_effects: Yield
    explained: int
    changed: int
    alone: tuple[Misfit, ...]
    unknown: tuple[Misfit, ...]
    more: int


def needed_effects(devices: Devices, found: LotEffects | None) -> NeededEffects | None:
    """The section's content, or ``None`` for a run whose misfits were not examined."""
    if found is None:
        return None
    verdicts, again = devices.text("verdict"), devices.text("verdict_with_effects")
    after = again.filled(verdicts)
    misfit, mended = devices.text("status").equals("misfit"), devices.text("status_with_effects").equals("ok")
    pairs, index = paired(verdicts, again)
    names = ("device_id", "lot", "missing_effect", "missing_effect_size", "missing_effect_reason")
    # Among millions of devices few are misfits: only their texts are kept.
    misfits = np.flatnonzero(misfit & ~mended).tolist()
    columns = [devices.text(name, misfits) for name in names]
    rows = [Misfit(*row) for row in zip(*columns) if row[4]]
    unknown = tuple(row for row in rows if row.missing in ("", "unknown"))
    alone = tuple(row for row in rows if row.missing not in ("", "unknown"))
    return NeededEffects(
        found,
        yield_of_verdicts(verdicts),
        yield_of_verdicts(after),
        int(np.sum(misfit & mended)),
        sum(n for (old, new), n in zip(pairs, np.bincount(index).tolist()) if new and new != old),
        alone[:_MOST_LISTED],
        unknown[:_MOST_LISTED],
        max(len(alone) - _MOST_LISTED, 0) + max(len(unknown) - _MOST_LISTED, 0),
    )


def counted(rows: tuple[Misfit, ...]) -> tuple[tuple[str, int], ...]:
    """Number of devices for each missing effect, most frequent first."""
    return tuple(sorted(Counter(row.missing for row in rows).items(), key=lambda item: (-item[1], item[0])))


def with_sd(mean: float | None, sd: float | None) -> str:
    """A size with its sd, to two digits of the sd: "(1.032 ± 0.018)e9"; "–" where it is unknown."""
    if mean is None or sd is None or sd <= 0.0:
        return "–"
    exponent = math.floor(math.log10(max(abs(mean), sd)))
    digits = min(max(1 - math.floor(math.log10(sd)) + exponent, 0), 9)
    if -3 <= exponent <= 3:
        places = max(digits - exponent, 0)
        return f"{mean:.{places}f} ± {sd:.{places}f}"
    return f"({mean / 10.0**exponent:.{digits}f} ± {sd / 10.0**exponent:.{digits}f})e{exponent}"


def probability(log_p: float) -> str:
    """A p-value from its logarithm, however small."""
    if log_p > math.log(1e-3):
        return f"{math.exp(log_p):.2g}"
    exponent = math.floor(log_p / math.log(10.0))
    return "< 1e-300" if exponent < -300 else f"{math.exp(log_p - exponent * math.log(10.0)):.1f}e{exponent}"
