"""The yield that a fitted model forecasts for wafers that it has not seen.

    y_held = prediction(y_fit) + (y_held* - prediction(y_fit*)),      y* drawn from the model      (conditional simulation)

The variances are drawn, too, so that the interval contains what a small lot does not know
of them.  Shapes: n devices, h of them held out, q quantities, B draws.

Source: Chiles, Delfiner, Geostatistics (2012), 7.3 (conditioning by kriging).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import BoolArray, FloatArray
from .design import arranged
from .elimination import LotFactor, factorised, solved
from .measured import MeasuredLot
from .model import LotModel
from .null import drawn_values
from .population import DeviceMixture
from .reml import centred

Conforms = Callable[[FloatArray], BoolArray]
#: Draws of the variances, and lots drawn with each.
VARIANCES, LOTS = 20, 20


@dataclass(frozen=True)
class YieldForecast:
    """Yield of the held-out devices: forecast mean, its 90 % interval, what was measured, and how many devices.

    ``position`` is the share of drawn lots with a smaller yield (half of the equal ones): 0.05 to 0.95 is inside.
    """

    mean: float
    low: float
    high: float
    measured: float
    devices: int
    position: float

    @property
    def inside(self) -> bool:
        """Whether the measured yield lies in the interval."""
        return self.low <= self.measured <= self.high


def forecast(
    lot: MeasuredLot,
    model: LotModel,
    draw: Callable[[np.random.Generator], FloatArray],
    mixtures: Sequence[DeviceMixture],
    conforms: Conforms,
    measured: FloatArray,
    seed: int,
) -> YieldForecast | None:
    """Forecast for the held-out devices of ``lot``; ``None`` where nothing is held out.

    Parameters
    ----------
    model : of the fit, for all devices of the lot.
    draw : variances (C,) as well as they are known.
    mixtures : whose changes were taken out of the values, and are drawn anew for the held-out devices.
    conforms : values (.., q) to whether a device conforms to all limits (..).
    measured : (n, q) the values as measured.
    """
    held = lot.is_held
    if not np.any(held):
        return None
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    hidden = replace(lot, values=np.where(held[:, None], np.nan, lot.values))
    every = arranged(replace(lot, values=np.nan_to_num(lot.values)), model)
    masked = arranged(hidden, model)
    yields: list[FloatArray] = []
    for _ in range(VARIANCES):
        trial = draw(generator)
        drawn = drawn_values(factorised(every, trial), LOTS, generator)
        given = np.concatenate([centred(hidden, model)[..., None], drawn], axis=2)
        factor = factorised(masked, trial)
        predicted = _predicted(factor, every.columns, given)[held]
        y = predicted[..., :1] + drawn[held] - predicted[..., 1:] + model.offset[held][..., None]
        for mixture in mixtures:
            own = mixture.subset(held)
            shift = own.mean[..., None] + np.einsum(
                "hqm,hmb->hqb", own.columns, generator.standard_normal((int(held.sum()), own.columns.shape[2], LOTS))
            )
            y = y + np.where(generator.random((int(held.sum()), 1, LOTS)) < own.share, shift, 0.0)
        yields.append(conforms(y.transpose(2, 0, 1)).mean(axis=1))
    found = np.concatenate(yields)
    own_yield = float(conforms(measured[held]).mean())
    low, high = np.quantile(found, [0.05, 0.95])
    position = float(np.mean(found < own_yield) + 0.5 * np.mean(found == own_yield))
    return YieldForecast(float(found.mean()), float(low), float(high), own_yield, int(held.sum()), position)


def _predicted(factor: LotFactor, columns: FloatArray, values: FloatArray) -> FloatArray:
    """(n, q, B) prediction of every device from the seen ones; ``columns`` (n, q, R) are not masked."""
    design = factor.design
    solution = solved(factor, values)
    scale = np.where(design.part >= 0, np.sqrt(factor.variances[design.part]), 1.0)
    there = design.slots >= 0
    wafer_of = np.empty(len(columns), dtype=np.int64)
    wafer_of[design.slots[there]] = np.nonzero(there)[0]
    a, b, c = design.ends
    lots = design.lot_of[wafer_of]
    wafers, lot, whole = solution.normals
    found = columns[:, :, c:] @ solution.coefficients
    for low, high, normals in ((0, a, wafers[wafer_of]), (a, b, lot[lots]), (b, c, whole)):
        if high > low:
            found = found + (columns[:, :, low:high] * scale[low:high]) @ normals
    return np.asarray(found)
