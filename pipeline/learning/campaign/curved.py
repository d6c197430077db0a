"""Curved terms: what they do to a record is absorbed by its free start to first order, so that a score promises nothing.

Shapes: N samples, S senses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.record import Record
from ...inference.general.fit import CampaignFit
from ...inference.general.residuals import CampaignResiduals
from ...inference.general.variation import RecordVariation


def curved_terms(model: Model, variation: RecordVariation | None) -> frozenset[str]:
    """Linear effects of the read-out with one parameter that starts which differ absorb to first order: a delay, a pole."""
    if variation is None or variation.spread.start_s == 0.0:
        return frozenset()
    library, shape = model.library, model.built.shape
    absent = (library[name] for name in model.candidates())
    return frozenset(e.name for e in absent if e.stages == ("readout",) and [m.unit for m in e.members(shape)] == ["s"])


def corrected_beside(model: Model, curved: Iterable[str], starts: Mapping[str, float]) -> frozenset[str]:
    """Those of the ``curved`` terms beside which the records were corrected: the ones with ``starts``.

    Without a refit a pole of 29 us at SNR 63, found before the records were corrected beside it, was not tried again: jitter
    had been measured as 5 % too large, and no structure was left (bench-one 17, seed 2038).
    """
    return frozenset(name for name in curved if model.parameters_of(name) & starts.keys())


def spread_starts(
    model: Model, terms: Iterable[str], curved: Collection[str], variation: RecordVariation | None
) -> dict[str, float]:
    """Start values of the ``curved`` ones of ``terms`` [s]: the spread of the starts.  At the null chi2 has no slope."""
    if variation is None:
        return {}
    library, shape = model.library, model.built.shape
    own = [library[term] for term in terms if term in curved]
    return {e.full_name(m): m.null + variation.spread.start_s for e in own for m in e.members(shape)}


def trigger_offset(
    problem: CampaignResiduals, fitted: CampaignFit, records: Sequence[Record], variation: RecordVariation | None
) -> tuple[FloatArray, ...]:
    """For each fit record (N S, 1) the column of a start shift common to all; none where the starts do not differ.

    Starts that differ have a mean that nobody knows, and a constant delay equals it.  The means of the other deviations are
    parameters of the plant.
    """
    if variation is None or variation.spread.start_s == 0.0:
        return ()
    start = slice(1, 2)
    return tuple(
        problem.whiten(problem.noise.common_v[r.name][start], problem.task(r, fitted.values)).reshape(1, -1).T
        for r in records
    )
