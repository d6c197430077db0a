"""A model of a lot arranged for elimination: devices by wafer, columns by level.

Columns stand in the order in which the levels are eliminated: wafer, lot, all (which includes testers, one set of columns
each), then the fixed ones.  Parts of the level "device" have no columns; they are covariances of single devices.

Shapes: n devices, W wafers of at most k devices, q quantities, R columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from .measured import MeasuredLot
from .model import LotModel, RandomPart, contribution

#: Added to the diagonal of a correlation matrix, so that two dies at one place keep it positive definite.
NUGGET = 1e-9


@dataclass(frozen=True, eq=False)
class LotDesign:
    """See the module.

    Parameters
    ----------
    model : whose parts the columns are.
    slots : (W, k) device in each place of each wafer, -1 where there is none.
    lot_of : (W,) lot of each wafer.
    noise : (n, q, q) measurement covariance; identity in quantities that were not seen.
    seen : (n, q).
    own : (D, n, q, q) covariance of each of the D parts of the level "device", and ``own_part`` (D,) their numbers.
    columns : (n, q, R).
    part : (R,) number of the random part of a column, -1 of a fixed one.
    ends : ends of the columns of the levels wafer, lot, all.
    """

    model: LotModel
    slots: IntArray
    lot_of: IntArray
    noise: FloatArray
    seen: BoolArray
    own: FloatArray
    own_part: IntArray
    columns: FloatArray
    part: IntArray
    ends: tuple[int, int, int]

    @property
    def rows(self) -> int:
        """Number of values that were seen."""
        return int(self.seen.sum())

    @property
    def fixed(self) -> int:
        """Number of fixed columns."""
        return self.columns.shape[2] - self.ends[2]

    def padded(self, values: FloatArray) -> FloatArray:
        """(n, q, B) -> (W, k q, B), zero where a wafer has no device."""
        found = values[self.slots]
        found[self.slots < 0] = 0.0
        return found.reshape(len(self.slots), -1, values.shape[-1])

    def unpadded(self, values: FloatArray) -> FloatArray:
        """The reverse of ``padded``."""
        w, k = self.slots.shape
        q = self.seen.shape[1]
        there = self.slots >= 0
        result = np.empty((len(self.seen), q, values.shape[-1]))
        result[self.slots[there]] = values.reshape(w, k, q, -1)[there]
        return result


def arranged(lot: MeasuredLot, model: LotModel) -> LotDesign:
    """The design of a model at the devices of a lot; the lot and the model list the same devices."""
    wafer, lots, tester = (lot.codes(level) for level in ("wafer", "lot", "tester"))
    order = np.argsort(wafer, kind="stable")
    counts = np.bincount(wafer)
    slots = np.full((len(counts), int(counts.max())), -1, dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    place = np.arange(len(order)) - np.repeat(starts, counts)
    slots[wafer[order], place] = order
    lot_of = lots[slots[:, 0]]

    seen = lot.seen
    own = [(k, contribution(part)) for k, part in enumerate(model.random) if part.level == "device"]
    blocks: list[FloatArray] = []
    numbers: list[IntArray] = []
    ends: list[int] = []
    done = 0
    for levels in (("wafer",), ("lot",), ("tester", "all")):
        for k, part in enumerate(model.random):
            if part.level in levels:
                columns = _columns(part, lot, slots, tester)
                blocks.append(columns)
                numbers.append(np.full(columns.shape[2], k, dtype=np.int64))
                done += columns.shape[2]
        ends.append(done)
    fixed = [part.columns for part in model.fixed]
    n, q = seen.shape
    whole = np.concatenate([np.zeros((n, q, 0)), *blocks, *fixed], axis=2) * seen[..., None]
    numbers.append(np.full(whole.shape[2] - done, -1, dtype=np.int64))
    both = seen[:, :, None] & seen[:, None, :]
    return LotDesign(
        model=model,
        slots=slots,
        lot_of=lot_of,
        noise=np.where(both, np.nan_to_num(lot.covariance), 0.0) + np.eye(q) * ~seen[:, None, :],
        seen=seen,
        own=np.stack([s * both for _, s in own]) if own else np.zeros((0, n, q, q)),
        own_part=np.array([k for k, _ in own], dtype=np.int64),
        columns=np.ascontiguousarray(whole),
        part=np.concatenate(numbers),
        ends=(ends[0], ends[1], ends[2]),
    )


def _columns(part: RandomPart, lot: MeasuredLot, slots: IntArray, tester: IntArray) -> FloatArray:
    """(n, q, r) columns of a part that is shared by more than one device."""
    if part.field_mm is not None:
        return field_roots(lot, slots, part.field_mm)[:, None, :] * part.columns
    if part.level == "tester":
        each = np.eye(int(tester.max()) + 1)[tester]
        return np.einsum("nqm,nt->nqtm", part.columns, each).reshape(*part.columns.shape[:2], -1)
    return part.columns


def field_roots(lot: MeasuredLot, slots: IntArray, length_mm: float) -> FloatArray:
    """(n, k) rows of the Cholesky factors of exp(-d / length) over the devices of each wafer."""
    x, y = np.nan_to_num(lot.x_mm), np.nan_to_num(lot.y_mm)
    roots = np.zeros((len(x), slots.shape[1]))
    for row in slots:
        own = row[row >= 0]
        distance = np.hypot(x[own, None] - x[own], y[own, None] - y[own])
        root = np.linalg.cholesky(np.exp(-distance / length_mm) + NUGGET * np.eye(len(own)))
        roots[own, : len(own)] = root
    return roots
