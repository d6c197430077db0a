"""Variation between records, estimated from the fit of a campaign.

    y_k = f(x) + C_k d_k + e,     d_k ~ N(0, D),     D = diag(s_phi^2, s_tau^2, s_g^2 .., s_b^2 ..)
    C_k = d f_k / d (phi, tau, g_1 .., b_1 ..)

The spreads s maximise the restricted likelihood of the fit records (``variance_components``).

Shapes: K fit records, N samples, S senses, P parameters, m deviations of a record; whitened columns in sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.forward.drive_groups import DriveGroup, drive_groups_of, highest_drive_energy
from ...experiment.forward.response import Starts, volts
from ...experiment.forward.sensitivity import STRONG
from ...experiment.forward.system import System, assemble
from ...experiment.instrument import Instrument
from ...experiment.noise.level import NoiseLevel, noise_level
from ...experiment.record import Campaign, Record
from ...experiment.variation import KINDS, Deviations, RecordSpread, advanced, kind_of_deviation
from .fit import CampaignFit, fit_campaign
from .linear_step import Sensitivity
from .residuals import CampaignResiduals, Tasks
from .variance_components import Grams, grams_of, solved, spread_of, with_residuals

#: Relative step of the frequency derivative: an eighth of a line width at a quality factor of 60,000.
_STEP = 1e-6
#: Step of the derivative by the start [s]: 3e-4 rad at 500 Hz, an error of 4e-8.
_DELAY_S = 1e-7
#: Largest spreads: frequency [1], start [samples], gain [1], ramp [V].  Three times the variation of a stable bench (10 ppm is
#: 1 K at a typical temperature coefficient); larger differences are another device or set-up, which must remain a misfit.
_LARGEST = (3e-5, 3.0, 3e-3, 0.1)
#: Largest numbers of fits, and of corrections of the records at one fit; they end when all deviations move by less than this
#: part of their sd or value, and the parameters end within this part of their sd where the linearization puts them.
_FITS, _CORRECTIONS, _SETTLED, _SETTLED_SHARE = 6, 8, 0.3, 1e-3
#: Share of the misfit by which chi2 changes when the fit of a wrong model counts as settled; its parameters may never settle.
_STUCK = 0.03


@dataclass(frozen=True, eq=False)
class RecordVariation:
    """The spreads, and the deviations of every driven record, fitted and held out."""

    spread: RecordSpread
    deviations: tuple[Deviations, ...]

    def of(self, record: str) -> Deviations | None:
        """The deviations of a record by name."""
        return next((one for one in self.deviations if one.record == record), None)


def at_frequency(model: Model, values: Mapping[str, float], phi: float) -> dict[str, float]:
    """Complete parameter ``values`` with every natural frequency of the plant times 1 + phi."""
    own = {p.name for p in model.built.parameters if p.unit == "Hz"}
    return {name: value * (1.0 + phi) if name in own else value for name, value in values.items()}


def _deviation_columns(
    model: Model, values: Mapping[str, float], group: DriveGroup, instrument: Instrument, starts: Starts
) -> FloatArray:
    """C (R, m, N, S) [V per unit] of the records of a drive group at complete ``values``."""
    up, down = (
        volts(assemble(model, at_frequency(model, values, phi), instrument, group.conditions), group, starts)
        for phi in (_STEP, -_STEP)
    )
    system = assemble(model, values, instrument, group.conditions)
    y, later, latest = (volts(_delayed(system, n * _DELAY_S), group, starts) for n in range(3))
    records, samples, senses = y.shape
    out = np.zeros((records, 2 + 2 * senses, samples, senses))
    out[:, 0] = (up - down) / (2.0 * _STEP)
    # Exactly the derivative by a constant delay, so that the two are seen to be the same.
    out[:, 1] = (4.0 * later - latest - 3.0 * y) / (2.0 * _DELAY_S)
    for k in range(records):
        for s in range(senses):
            out[k, 2 + s, :, s] = y[k, :, s]
            out[k, 2 + senses + s, :, s] = np.linspace(-1.0, 1.0, samples)
    return out


def _delayed(system: System, delay_s: float) -> System:
    """The system with a longer delay in its readout."""
    return replace(system, readout=replace(system.readout, delay_s=system.readout.delay_s + delay_s))


def deviation_columns(
    fit: CampaignFit, records: Sequence[Record], campaign: Campaign, values: Mapping[str, float] | None = None
) -> dict[str, FloatArray]:
    """C (m, N, S) [V per unit of the deviation] of each of ``records``, by name.

    The columns are those at complete parameter ``values``; ``None`` means those of the fit.
    """
    at = fit.values if values is None else values
    known = {record.name: record.start for record in fit.records}
    out: dict[str, FloatArray] = {}
    for places, group in drive_groups_of(records, campaign.instrument, campaign.angular_gain):
        starts = [known.get(records[i].name) for i in places]
        found = _deviation_columns(fit.model, at, group, campaign.instrument, starts)
        out |= {records[i].name: c for i, c in zip(places, found)}
    return out


def record_variation(fit: CampaignFit, campaign: Campaign, most: int = len(KINDS), threads: int = 1) -> RecordVariation:
    """The spreads, from the fit records, and the deviations of all driven records at a fit.

    Parameters
    ----------
    fit : of the campaign.
    campaign : its records; deviations of first order are still in them.
    most : number of kinds of variation that may be found.
    threads : how many records are integrated at once.
    """
    driven = (*campaign.with_role("fit"), *campaign.with_role("validate"))
    linear = _linearized(fit, campaign, deviation_columns(fit, driven, campaign), threads)
    g, residuals = _with_records(linear, campaign)
    return _estimated(linear, g, residuals, _spread(linear, g, most))[0]


@dataclass(frozen=True, eq=False)
class _Linearized:
    """A campaign linearized at a fit.

    Parameters
    ----------
    fit : the fit.
    c_v : deviation columns (m, N, S) [V per unit] by record.
    residuals : the problem without common signals.
    tasks : the driven records, those of the fit first.
    columns, jacobians : C (n, m) of every driven record and J (n, P) with the initial states of the fit records, in sigmas.
    products : of the columns of the fit records; those with the residual are not used.
    """

    fit: CampaignFit
    c_v: Mapping[str, FloatArray]
    residuals: CampaignResiduals
    tasks: Tasks
    columns: Sequence[FloatArray]
    jacobians: Sequence[FloatArray]
    products: Grams


def _linearized(fit: CampaignFit, campaign: Campaign, c_v: Mapping[str, FloatArray], threads: int) -> _Linearized:
    problem = CampaignResiduals(fit.model, campaign, replace(fit.noise, common_v={}), threads)
    fitted = campaign.with_role("fit")
    driven = (*fitted, *campaign.with_role("validate"))
    known = {record.name: record for record in fit.records}
    tasks = problem.tasks(driven, fit.values)
    starts = [known[r.name].start for r in driven]
    columns = [problem.whiten(c_v[t.record.name], t).reshape(len(c_v[t.record.name]), -1).T for t in tasks.each]
    reference = highest_drive_energy([r.drive_v for r in fitted])
    exact = problem.strength(fit.values, tasks.each[reference]) > STRONG
    steps = problem.steps(fit.values, tasks.each[reference], starts[reference])
    jacobians = problem.columns(fit.values, tasks, starts, exact, steps)
    free = [None if s is None else problem.start_columns(fit.values, t, s, exact) for t, s in zip(tasks.each, starts)]
    count = len(fitted)
    wide = _with_starts(list(zip(jacobians[:count], free[:count])))
    none = [np.zeros(j.shape[0]) for j in wide]
    products = grams_of(columns[:count], wide, none)
    return _Linearized(fit, c_v, problem, tasks, columns, (*wide, *jacobians[count:]), products)


def _with_records(linear: _Linearized, campaign: Campaign) -> tuple[Grams, list[FloatArray]]:
    """The products and the residuals (n,) of every driven record, in sigmas, for the records of ``campaign``."""
    known = {record.name: record.predicted_v for record in linear.fit.records}
    measured = {record.name: record.sense_v for record in campaign.records}
    names = [(t, t.record.name) for t in linear.tasks.each]
    residuals = [linear.residuals.whiten(measured[name] - known[name], t).reshape(-1) for t, name in names]
    count = len(linear.products.cc)
    own = (linear.columns[:count], linear.jacobians[:count], residuals[:count])
    return with_residuals(linear.products, *own), residuals


def _spread(linear: _Linearized, g: Grams, most: int) -> RecordSpread:
    first = linear.tasks.each[0].record
    largest = np.array(_LARGEST) * (1.0, 1.0 / first.sample_rate_hz, 1.0, 1.0)
    return spread_of(g, kind_of_deviation(first.sense_v.shape[1]), largest, most)


def _estimated(
    linear: _Linearized, g: Grams, residuals: Sequence[FloatArray], spread: RecordSpread
) -> tuple[RecordVariation, FloatArray]:
    """The deviations of the records at given spreads, and the step (P,) of the parameters that goes with them."""
    tasks, count = linear.tasks.each, len(linear.products.cc)
    sd = spread.of_deviations(tasks[0].record.sense_v.shape[1])
    best = solved(g, sd)
    out = [
        Deviations(t.record.name, d, np.sqrt(np.diagonal(v)))
        for t, d, v in zip(tasks, best.deviations, best.covariances)
    ]
    dx = best.dx[: len(linear.fit.names)]
    for t, c, j, r in zip(tasks[count:], linear.columns[count:], linear.jacobians[count:], residuals[count:]):
        # The parameters come from the fit records only.
        alone = solved(grams_of([c], [np.zeros((r.size, 1))], [r - j @ dx]), sd)
        out.append(Deviations(t.record.name, alone.deviations[0], np.sqrt(np.diagonal(alone.covariances[0]))))
    return RecordVariation(spread, tuple(out)), dx


def _with_starts(sensitivities: Sequence[Sensitivity]) -> list[FloatArray]:
    """For each record the columns (N S, P + all initial states): those of the parameters, then of every initial state."""
    width = sum(0 if f is None else f.shape[1] for _, f in sensitivities)
    out, place = [], 0
    for j, f in sensitivities:
        wide = np.zeros((j.shape[0], width))
        if f is not None:
            wide[:, place : place + f.shape[1]] = f
            place += f.shape[1]
        out.append(np.concatenate([j, wide], axis=1))
    return out


def aligned(
    campaign: Campaign, fit: CampaignFit, variation: RecordVariation, values: Mapping[str, float] | None = None
) -> Campaign:
    """The campaign without the estimated deviations:  y' = advanced(y - b l, tau) / (1 + g) - (f(phi) - f(0)).

    The first order alone does not suffice where they are large.  Only the driven records change.  f is the model at complete
    parameter ``values``; ``None`` means those of the fit.
    """
    at = fit.values if values is None else values
    known = {record.name: record.start for record in fit.records}
    predicted = {record.name: record.predicted_v for record in fit.records}
    model, instrument = fit.model, campaign.instrument

    def equal(record: Record) -> Record:
        d = variation.of(record.name)
        if d is None:
            return record
        ((_, group),) = drive_groups_of([record], instrument, campaign.angular_gain)
        shifted, plain = (
            volts(
                assemble(model, at_frequency(model, at, phi), instrument, group.conditions),
                group,
                [known.get(record.name)],
            )[0]
            for phi in (d.frequency, 0.0)
        )
        ramp = d.ramp_v * np.linspace(-1.0, 1.0, record.sense_v.shape[0])[:, None]
        measured = _filled(record, predicted[record.name])
        y = advanced(measured - ramp, d.start_s, record.sample_rate_hz) / (1.0 + d.gain)
        return replace(record, sense_v=y - (shifted - plain))

    return replace(campaign, records=tuple(equal(record) for record in campaign.records))


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


def fit_with_variation(model: Model, campaign: Campaign, fit: CampaignFit, threads: int = 1) -> VariedFit:
    """The fit of ``model`` with the variation between the records, from a fit without it.

    The records are corrected and fitted again until the fit moves as its linearization predicts.  ``campaign`` is the measured
    one.
    """
    corrected, driven = campaign, [r for r in campaign.records if r.role in ("fit", "validate")]
    for iteration in range(_FITS):
        linear = _linearized(fit, campaign, deviation_columns(fit, driven, campaign), threads)
        # A large start shift has second-order terms that look like the other kinds, so the first correction is of one kind.
        most = (1, len(KINDS)) if iteration == 0 else (len(KINDS),)
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
        missed = np.abs(fit.x - fit.model.to_internal(moved))
        settled = bool(np.all(missed <= _SETTLED * np.sqrt(np.maximum(np.diagonal(fit.x_covariance), 0.0))))
        if iteration > 0 and (settled or abs(fit.chi2 - before.chi2) < _STUCK * (fit.chi2 - fit.dof)):
            break
    return VariedFit(fit, corrected, noise, found)


def _corrected(
    linear: _Linearized, measured: Campaign, corrected: Campaign, most: tuple[int, ...]
) -> tuple[RecordVariation, Campaign, dict[str, float]]:
    """The variation at a fit, to second order; the campaign without the deviations; the parameter values that go with them.

    The columns stay the same while the records are corrected.  The spreads are estimated before the first corrections, of at
    most ``most`` kinds each.
    """
    previous, spread, model = None, RecordSpread(), linear.fit.model
    for correction in range(_CORRECTIONS):
        g, residuals = _with_records(linear, corrected)
        if correction < len(most):
            spread = _spread(linear, g, most[correction])
        found, dx = _estimated(linear, g, residuals, spread)
        if spread.is_zero:
            return found, measured, linear.fit.values
        # Deviations and parameters are solved for together: the deviations are those at the moved parameters.
        moved = model.to_values(linear.fit.x + dx)
        moved = moved if model.allowed(moved) else linear.fit.values
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
    """Whether the deviations of all records moved by less than ``_SETTLED`` of their sd, or of themselves."""
    for one in after.deviations:
        other = before.of(one.record)
        assert other is not None
        if np.any(np.abs(one.value - other.value) > np.maximum(_SETTLED * one.sd, _SETTLED_SHARE * np.abs(one.value))):
            return False
    return True
