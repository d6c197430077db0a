"""Two questions about a lot that was measured tonight: does it come from this population, and does it differ from earlier lots?

    origin   the population as its file states it, v = 1, against every mean, pattern and spread (``departures``)
    drift    all lots together, refitted; what tonight's devices have apart: mean, gradient, bow, spread

The drift takes the spreads from lot to lot and from wafer to wafer as fitted, or as stated where that is larger: a few lots do
not show how far lots differ.  A refit, a name and a cause are the business of ``loop``.

Shapes: n devices, q quantities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import binomtest

from ...arrays import BoolArray, FloatArray
from .departures import Departure, Tested, departures_of, smallest_seen
from .design import arranged
from .measured import MeasuredLot
from .model import FixedPart, LotModel, RandomPart, means, merged
from .origin_answers import DepartureAnswer, DriftAnswer, OriginAnswer
from .outcome import left_out, members, with_curvature, with_mixture
from .population import LotPopulation, generic_parts, spread_of
from .prepared import free, prepared
from .reml import LotFit
from .tails import mixture_scores, outliers

#: Departures that an answer lists.
LISTED = 12
#: Fewer devices leave the question undecided unless the lot departs.  Of n normal values (n - 1) s^2 is chi-square; where the sd
#: is doubled, it exceeds its quantile for p = 0.01 / 300 (about 300 tests) with a probability of 90 % from n = 25 on.
LEAST_DEVICES = 25


def origin(lot: MeasuredLot, population: LotPopulation, false_alarm: float, seed: int = 0) -> OriginAnswer:
    """Whether ``lot`` comes from ``population``, at a family-wise rate of false alarms.

    Raises
    ------
    numpy.linalg.LinAlgError : a device has no variance in some direction.
    """
    n, q = lot.values.shape
    model = replace(population.model, fixed=(), random=merged(population.model.random))
    ones = np.ones(len(model.random))
    clean = with_curvature(lot, population.curvature)
    shares = []
    for mixture in population.mixtures:
        # With free means, so that a shifted lot is no lot of leaks.
        chosen = members(clean, replace(model, fixed=(means(n, q),)), ones, mixture)
        clean = with_mixture(clean, mixture, chosen)
        shares.append((mixture.name, mixture.share, int(chosen.sum())))
    fit = _stated(clean, model)
    scale = spread_of(lot)
    out = left_out(clean, model, ones)
    further = [float(np.log(binomtest(count, n, share).pvalue)) for _, share, count in shares]
    further.append(mixture_scores(out, [outliers(clean, scale)])[0].log_p)
    patterns = [part for part in free(population.model).fixed if part.size is not None]
    absent = [*_means(lot, scale), *patterns, *generic_parts(lot, scale, False), *generic_parts(lot, scale, True)]
    found, p = departures_of(fit, absent, True, further, seed)
    rows = [*found.departures]
    rows += [
        Departure(f"{name} (share)", "spread", "device", share, count / n, np.nan, np.nan, log_p, family)
        for (name, share, count), log_p, family in zip(shares, further, p)
    ]
    rows.append(Departure("outliers", "spread", "device", 0.0, np.nan, np.nan, np.nan, further[-1], p[-1]))
    smallest = min(row.p_value for row in rows)
    departs = smallest < false_alarm
    few = n < LEAST_DEVICES and not departs
    return OriginAnswer(
        population=population.name,
        devices=n,
        verdict="departs" if departs else "undecided" if few else "from_population",
        p_value=smallest,
        false_alarm=false_alarm,
        departures=_listed(rows, false_alarm),
        smallest_shift=_smallest(fit, lot, scale, found, false_alarm, None),
        reason=_few(n) if few else None,
    )


def drift(
    lot: MeasuredLot,
    tonight: BoolArray,
    population: LotPopulation,
    nights: Sequence[str],
    false_alarm: float,
    seed: int = 0,
) -> DriftAnswer:
    """Whether the devices ``tonight`` (n,) of ``lot`` differ from the others, which earlier nights measured.

    Raises
    ------
    MeasurementError, numpy.linalg.LinAlgError : the devices do not determine the model.
    """
    ready = prepared(lot, population)
    fit = ready.fit(free(population.model), np.maximum(ready.start, 1e-4))
    shared = np.array([part.level in ("lot", "wafer", "tester") for part in fit.model.random])
    fit = replace(fit, variances=np.where(shared, np.maximum(fit.variances, 1.0), fit.variances))
    scale = spread_of(lot)
    found, _ = departures_of(fit, _tonight(ready.whole, tonight, scale), False, (), seed)
    count, smallest = int(tonight.sum()), found.p_value
    drifted = smallest < false_alarm
    few = count < LEAST_DEVICES and not drifted
    reason = None
    if not fit.converged:
        reason = "the spreads of these nights could not be fitted"
    elif few:
        reason = _few(count)
    return DriftAnswer(
        nights=tuple(nights),
        devices=count,
        earlier_devices=len(tonight) - count,
        verdict="undecided" if reason else "drifted" if drifted else "no_drift",
        p_value=smallest,
        false_alarm=false_alarm,
        departures=_listed(found.departures, false_alarm),
        smallest_shift=_smallest(fit, lot, scale, found, false_alarm, tonight),
        reason=reason,
    )


def _few(devices: int) -> str:
    return f"{devices} devices, and fewer than {LEAST_DEVICES} often hide a spread that has doubled"


def _stated(lot: MeasuredLot, model: LotModel) -> LotFit:
    """The model as a fit whose variances are those that it states."""
    count = len(model.random)
    return LotFit(
        lot, arranged(lot, model), np.ones(count), np.nan, np.zeros((count, count)), np.zeros(count), converged=True
    )


def _means(lot: MeasuredLot, scale: FloatArray, rows: BoolArray | None = None) -> tuple[FixedPart, ...]:
    """A shift of each quantity by its spread, of all devices or of those in ``rows`` (n,)."""
    n, q = lot.values.shape
    found = []
    for k, quantity in enumerate(lot.quantities):
        columns = np.zeros((n, q, 1))
        columns[:, k, 0] = scale[k] * (np.ones(n) if rows is None else rows)
        found.append(FixedPart(f"mean({quantity})", columns))
    return tuple(found)


def _tonight(lot: MeasuredLot, tonight: BoolArray, scale: FloatArray) -> list[FixedPart | RandomPart]:
    """What tonight's devices may have apart: for each quantity a mean, a gradient, a bow, a spread from device to device."""
    shapes = {"gradient": np.stack([lot.x, lot.y], axis=1), "bow": (lot.x**2 + lot.y**2 - 0.5)[:, None]}
    found: list[FixedPart | RandomPart] = [*_means(lot, scale, tonight)]
    n, q = lot.values.shape
    for k, quantity in enumerate(lot.quantities):
        for name, shape in shapes.items():
            columns = np.zeros((n, q, shape.shape[1]))
            columns[:, k] = scale[k] * shape * tonight[:, None]
            found.append(FixedPart(f"{name}({quantity})", columns))
        own = np.zeros((n, q, 1))
        own[:, k, 0] = scale[k] * tonight
        found.append(RandomPart(f"device_spread({quantity})", "device", own))
    return found


def _smallest(
    fit: LotFit, lot: MeasuredLot, scale: FloatArray, found: Tested, false_alarm: float, rows: BoolArray | None
) -> dict[str, float]:
    return {
        quantity: smallest_seen(fit, part, found.tests, false_alarm)
        for quantity, part in zip(lot.quantities, _means(lot, scale, rows))
    }


def _listed(rows: Sequence[Departure], false_alarm: float) -> tuple[DepartureAnswer, ...]:
    chosen = sorted((row for row in rows if row.p_value < false_alarm), key=lambda row: row.log_p)
    return tuple(_answer(row) for row in chosen[:LISTED])


def _answer(row: Departure) -> DepartureAnswer:
    name, _, rest = row.name.partition("(")
    quantity = rest.removesuffix(")") if rest and not row.name.endswith("(share)") else None
    pattern = row.name if quantity is None and row.kind == "pattern" else name if row.kind == "pattern" else None
    return DepartureAnswer(
        part=row.name,
        kind=row.kind,
        quantity=quantity,
        pattern=pattern,
        level=row.level,
        stated=row.stated,
        estimate=row.estimate if np.isfinite(row.estimate) else None,
        low=row.low if np.isfinite(row.low) else None,
        high=row.high if np.isfinite(row.high) else None,
        p_value=row.p_value,
    )
