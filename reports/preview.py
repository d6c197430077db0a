"""What a run configuration implies, from a quick draw of the population without any record: for `run --dry-run`.

Shapes: B drawn devices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IntArray
from pipeline.quantities import AXES

from .clusters import effective_number
from .limits import Limits
from .yields import Interval, clopper_pearson

#: Quantities whose distribution is shown, beside the limited ones.
_SHOWN = ("f1_hz", "f2_hz", "f3_hz", "split_hz")
#: Quantiles of the distribution.
QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class DrawnQuantity:
    """The 5, 50 and 95 % points of a true quantity (nan of an angle modulo 180 deg), and the share beyond its limit.

    ``loss`` is the interval of that share; ``None`` where there is no limit.
    """

    name: str
    quantiles: tuple[float, float, float]
    share: float
    loss: Interval | None


@dataclass(frozen=True)
class Preview:
    """Expected yield of ``drawn`` devices of ``lots`` lots: the share that truly conforms, with its interval.

    ``nominal`` are quantities of the device without irregularities.
    """

    drawn: int
    lots: int
    nominal: Mapping[str, float]
    share: float
    interval: Interval
    quantities: tuple[DrawnQuantity, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        plain = asdict(self)
        plain["quantities"] = {row.pop("name"): row for row in plain["quantities"]}
        return plain


def preview_of(
    true: Mapping[str, FloatArray], nominal: Mapping[str, FloatArray], limits: Limits, lots: Sequence[str]
) -> Preview:
    """The preview of devices with the quantities ``true`` (B,) in the lots ``lots`` (B,), given the nominal ones (1,).

    Lots are the independent draws (Korn and Graubard; see ``clusters``); with a device in each, that is Clopper-Pearson.
    """
    groups, index = np.unique(np.asarray(lots), return_inverse=True)
    conform = np.ones(len(lots), dtype=np.bool_)
    share: dict[str, float] = {}
    loss: dict[str, Interval] = {}
    for limit in limits.limits:
        admitted = limit.admits(true[limit.quantity])
        conform &= admitted
        share[limit.quantity] = float(np.mean(~admitted))
        loss[limit.quantity] = _interval(~admitted, index, groups.size)
    names = dict.fromkeys((*_SHOWN, *limits.quantities))
    return Preview(
        len(lots),
        groups.size,
        {name: float(nominal[name][0]) for name in (*_SHOWN, "quality1", "quality2", "quality3")},
        float(conform.mean()),
        _interval(conform, index, groups.size),
        tuple(
            DrawnQuantity(
                name,
                _quantiles(true[name]) if name not in AXES else (float("nan"),) * 3,
                share.get(name, float("nan")),
                loss.get(name),
            )
            for name in names
        ),
    )


def _interval(counted: BoolArray, index: IntArray, groups: int) -> Interval:
    if groups in (1, counted.size):
        return clopper_pearson(float(counted.sum()), float(counted.size))
    found = effective_number(counted.astype(np.float64), index, groups)
    return clopper_pearson(found.share * found.effective, found.effective)


def _quantiles(values: FloatArray) -> tuple[float, float, float]:
    known: Sequence[float] = np.quantile(values[np.isfinite(values)], QUANTILES).tolist()
    return known[0], known[1], known[2]
