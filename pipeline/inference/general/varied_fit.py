"""The fit of a campaign whose records differ: the records are corrected and fitted in turn.

    y'_k = y_k without the estimated deviations d_k,  + C_k d_k,        x^ = argmin of the fit with noise I + C_k D C_k'

Shapes: K fit records, N samples, S senses, P parameters, m deviations of a record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.forward.drive_groups import drive_groups_of
from ...experiment.forward.system import assemble
from ...experiment.noise.level import NoiseLevel, noise_level
from ...experiment.record import Campaign, Record
from ...experiment.variation import KINDS, RecordSpread, advanced
from .deviation_columns import at_frequency, deviation_columns, response_for
from .fit import CampaignFit, fit_campaign
from .gauss_newton import CLOSE, FAINT, PATIENCE, SETTLED
from .variation import Linearized, RecordVariation, estimated, linearized, spread_at, with_records

#: Rise of chi2 after a correction that left the range of the linearization; the result before it is kept.  A pole beside starts
#: that differ went from 21 us to 350 us in one step, and chi2 rose 48 times (bench-one 17, seed 2038).  Less noise, once the
#: records are equal, raises it by 5 %.
_LEFT = 2.0


def aligned(
    campaign: Campaign, fit: CampaignFit, variation: RecordVariation, values: Mapping[str, float] | None = None
) -> Campaign:
    """The campaign without the estimated deviations:  y' = advanced(y - b l, tau) / (1 + g) - (f(phi) - f(0)).

    The first order alone does not suffice where they are large.  Only the driven records change.  f is the model at complete
    parameter ``values``; ``None`` means those of the fit.  A record that the model clips is not band-limited and cannot be
    advanced; there, y' = (y - b l) / (1 + g) - (f(phi, tau) - f(0)).
    """
    at, respond = fit.values if values is None else values, response_for(fit, campaign)
    known = {record.name: record.start for record in fit.records}
    predicted = {record.name: record.predicted_v for record in fit.records}
    model, instrument = fit.model, campaign.instrument
    clipped = clips(model)

    def equal(record: Record) -> Record:
        d = variation.of(record.name)
        if d is None:
            return record
        ((_, group),) = drive_groups_of([record], instrument, campaign.angular_gain)
        shifted, plain = (
            respond(
                assemble(model, at_frequency(model, at, phi), instrument, group.conditions),
                group,
                [known.get(record.name)],
                (delay_s,),
            )[0, 0]
            for phi, delay_s in ((d.frequency, d.start_s if clipped else 0.0), (0.0, 0.0))
        )
        ramp = d.ramp_v * np.linspace(-1.0, 1.0, record.sense_v.shape[0])[:, None]
        y = _filled(record, predicted[record.name]) - ramp
        if not clipped:
            y = advanced(y, d.start_s, record.sample_rate_hz)
        return replace(record, sense_v=y / (1.0 + d.gain) - (shifted - plain))

    return replace(campaign, records=tuple(equal(record) for record in campaign.records))


def clips(model: Model) -> bool:
    """Whether an effect of the model changes the samples at the converter, where they are no longer band-limited."""
    return any("adc" in model.library[name].stages for name in model.effects)


def _filled(record: Record, predicted_v: FloatArray) -> FloatArray:
    """The samples (N, S) [V] with bad ones replaced by the prediction; a time shift would spread them."""
    if record.good is None:
        return record.sense_v
    difference = np.where(record.good, record.sense_v - predicted_v, 0.0)
    offset = difference.sum(axis=0) / np.maximum(record.good.sum(axis=0), 1)
    return np.where(record.good, record.sense_v, predicted_v + offset)


def _with_first_order(campaign: Campaign, variation: RecordVariation, columns: Mapping[str, FloatArray]) -> Campaign:
    """The campaign with C d added to every driven record: the likelihood is linear around the estimated deviations."""

    def with_deviations(record: Record) -> Record:
        d = variation.of(record.name)
        if d is None:
            return record
        return replace(record, sense_v=record.sense_v + np.tensordot(d.value, columns[record.name], axes=1))

    return replace(campaign, records=tuple(with_deviations(record) for record in campaign.records))


@dataclass(frozen=True, eq=False)
class VariedFit:
    """A fit in which the records may differ: the corrected campaign, the noise with the common signals, and the variation."""

    fit: CampaignFit
    campaign: Campaign
    noise: NoiseLevel
    variation: RecordVariation


def fit_with_variation(
    model: Model, campaign: Campaign, fit: CampaignFit, threads: int = 1, known: RecordVariation | None = None
) -> VariedFit:
    """The fit of ``model`` with the variation between the records, from a fit without it.

    ``known`` is the variation beside a similar model, with which the corrections begin: beside a pole and a drift, the second
    order of starts that differed by 55 us went into the gains, and the fit ended without damping (bench-one 17, seed 2038).

    The records are corrected and fitted again until the fit ends within ``SETTLED`` of its sd where its linearization puts it, or
    chi2 changes by less than ``CLOSE`` of the misfit: a wrong model may never settle.  ``campaign`` is the measured one.
    """
    best: VariedFit | None = None
    corrected, driven = campaign, [r for r in campaign.records if r.role in ("fit", "validate")]
    for iteration in range(PATIENCE):
        columns = deviation_columns(fit, driven, campaign)
        linear = linearized(fit, campaign, columns, threads)
        if iteration == 0 and known is not None:
            corrected = _with_first_order(aligned(campaign, fit, known, fit.values), known, columns)
        # A large start shift has second-order terms that look like the other kinds, so the first correction is of one kind.
        most = (1, len(KINDS)) if iteration == 0 and known is None else (len(KINDS),)
        found, equal, moved = _corrected(linear, campaign, corrected, most)
        if found.spread.is_zero:
            return VariedFit(fit, campaign, replace(fit.noise, common_v={}), found)
        # A common frequency and the deviations from it are nearly the same, so the columns of both must hold at one point: with
        # those of the previous fit the mean frequency went back and forth by 0.6 sd and did not settle.
        columns = deviation_columns(fit, driven, campaign, moved)
        corrected = _with_first_order(equal, found, columns)
        sd = found.spread.of_deviations(driven[0].sense_v.shape[1])[:, None, None]
        # Repeats measure the noise level once their records are equal.
        noise = replace(
            noise_level(equal), mixing=fit.noise.mixing, common_v={name: sd * c for name, c in columns.items()}
        )
        before, fit = fit, fit_campaign(model, corrected, noise, moved, threads=threads)
        if best is not None and fit.chi2 > _LEFT * best.fit.chi2:
            return best
        best = VariedFit(fit, corrected, noise, found)
        missed = np.abs(fit.x - fit.model.to_internal(moved))
        settled = bool(np.all(missed <= SETTLED * np.sqrt(np.maximum(np.diagonal(fit.x_covariance), 0.0))))
        if iteration > 0 and (settled or abs(fit.chi2 - before.chi2) < CLOSE * (fit.chi2 - fit.dof)):
            break
    assert best is not None
    return best


def _corrected(
    linear: Linearized, measured: Campaign, corrected: Campaign, most: tuple[int, ...]
) -> tuple[RecordVariation, Campaign, dict[str, float]]:
    """The variation at a fit, to second order; the campaign without the deviations; the parameter values that go with them.

    The columns stay the same while the records are corrected.  The spreads are estimated before the first corrections, of at
    most ``most`` kinds each.
    """
    previous, spread, model = None, RecordSpread(), linear.fit.model
    for correction in range(PATIENCE):
        g, residuals = with_records(linear, corrected)
        if correction < len(most):
            spread = spread_at(linear, g, most[correction])
        found, dx = estimated(linear, g, residuals, spread)
        if spread.is_zero:
            return found, measured, linear.fit.values
        # Deviations and parameters are solved for together: the deviations are those at the moved parameters.
        moved = model.to_values(linear.fit.x + dx)
        if not model.allowed(moved):
            # Deviations that go with a step that is not taken align the records wrongly.
            found, moved = estimated(linear, g, residuals, spread, held=True)[0], linear.fit.values
        found, mean = _without_mean_frequency(found, len(linear.products.cc))
        moved = at_frequency(model, moved, mean)
        equal = aligned(measured, linear.fit, found, moved)
        corrected = _with_first_order(equal, found, linear.c_v)
        if previous is not None and correction >= len(most) and _settled(previous, found):
            break
        previous = found
    return found, equal, moved


def _without_mean_frequency(found: RecordVariation, count: int) -> tuple[RecordVariation, float]:
    """The deviations without the mean frequency [1] of the first ``count`` records, and that mean: it belongs to the plant."""
    mean = float(np.mean([one.frequency for one in found.deviations[:count]]))
    out = []
    for one in found.deviations:
        value = one.value.copy()
        value[0] -= mean
        out.append(replace(one, value=value))
    return RecordVariation(found.spread, tuple(out)), mean


def _settled(before: RecordVariation, after: RecordVariation) -> bool:
    """Whether the deviations of all records moved by less than ``SETTLED`` of their sd, or ``FAINT`` of themselves."""
    for one in after.deviations:
        other = before.of(one.record)
        assert other is not None
        if np.any(np.abs(one.value - other.value) > np.maximum(SETTLED * one.sd, FAINT * np.abs(one.value))):
            return False
    return True
