"""Identification of one device in the band: from its fit records to the columns of the devices table.

    fit records -> the paper's route -> start -> maximum likelihood -> posterior -> quantities -> status

Shapes: records (N, 2) [V]; cartesian parameters (12,).  Results in the units of ``pipeline.quantities``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...device.mechanics import Modes
from ...experiment.antialias import behind_filter
from ...experiment.forward.modal_bank import respond
from ...experiment.forward.recursion import Lanes
from ...experiment.instrument import Instrument
from ...experiment.noise.spectrum import NoiseSpectrum
from ...experiment.record import Record
from ...identification.failure import IdentificationError
from ...identification.route import RouteResult, identify_record
from ..estimate import RateSettings
from ..gate import Gate
from ..general.starts import gyro_start
from .compressed import BandData, nuisance_basis
from .fit import Fit, maximise, modes_at, start_from_modes
from .inband import Band, make_band
from .kept import kept_if_short
from .mismatch import MismatchPrior
from .quality import full_band_quality, with_dependent_noise
from .refill import refilled_fit
from .result import UNDETERMINED, DeviceResult, Fitted, Value, failed_result, results_of
from .sample import SamplerSettings, sample
from .undetected.clipping import loud_samples
from .undetected.device import Scoring
from .whitening import band_noise


@dataclass(frozen=True)
class IdentificationSettings:
    """Order and window [s] of the paper's route, band [Hz] of the likelihood, mains frequency [Hz] in the model if any.

    ``mismatch`` is the prior of the electrode mismatches; ``None`` where they are not in the model.
    """

    order: int = 40
    window_s: float = 2.0
    low_hz: float = 400.0
    high_hz: float = 700.0
    line_hz: float | None = None
    mismatch: MismatchPrior | None = None


@dataclass(frozen=True, eq=False)
class FitRecord:
    """A fit record with its band and nuisance basis (2 W, L) [1], shared by all devices with the same drive.

    ``filtered_drive_v`` is its drive behind the bandpass of the paper's route (N, 2) [V], and ``drive_lanes`` its drive as the
    modal bank takes it, where they are known already.
    """

    record: Record
    band: Band
    nuisance: FloatArray
    filtered_drive_v: FloatArray | None = None
    drive_lanes: Lanes | None = None


def prepare(record: Record, instrument: Instrument, settings: IdentificationSettings) -> FitRecord:
    """``record`` with its band and nuisance basis (2 W, L) [1]; ConfigError as in ``make_band``."""
    band = make_band(record.drive_v, instrument, settings.low_hz, settings.high_hz)
    return FitRecord(record, band, nuisance_basis(band, settings.line_hz))


@kept_if_short(4)
def _drives_all(band: Band) -> bool:
    """Whether the drive of a record reaches every electrode, as the paper's route needs it."""
    return all(np.any(drive_v) for drive_v in band.drive_v.T)


def _route_columns(route: RouteResult) -> dict[str, Value]:
    return {
        "theta_u1_deg": route.axes.theta_u1_deg,
        "theta_v1_deg": route.axes.theta_v1_deg,
        "theta_u2_deg": route.axes.theta_u2_deg,
        "theta_v2_deg": route.axes.theta_v2_deg,
        "arx_split_hz": route.arx_split_hz,
    }


def _starts(routes: Sequence[RouteResult]) -> list[FloatArray]:
    """Start values (12,): the modes of each route, with and without its estimate of the damping anisotropy."""
    out: list[FloatArray] = []
    for route in routes:
        start = start_from_modes(route.poles, route.residues)
        out.append(start)
        flat = start.copy()
        flat[4:6] = 0.0
        out.append(flat)
    return [start for start in out if np.all(np.isfinite(start))]


def _spectral_starts(
    fit_records: Sequence[FitRecord], sigma_v: FloatArray, instrument: Instrument, settings: IdentificationSettings
) -> list[FloatArray]:
    """Start values (12,) from the spectra of the records instead of an ARX model; none if they do not show three modes."""
    records = [item.record for item in fit_records]
    try:
        start = gyro_start(records, instrument, sigma_v, settings.low_hz, settings.high_hz)
    except (np.linalg.LinAlgError, ValueError):
        return []
    return [start] if np.all(np.isfinite(start)) else []


def _rank(fit: Fit) -> tuple[bool, float]:
    return fit.converged, -fit.chi2


def explains(fit: Fit) -> bool:
    """Whether the fit converged to a chi2 that is at most 6 sd above its degrees of freedom."""
    sd = fit.likelihood.chi2_sd or math.sqrt(2.0 * fit.dof)
    return fit.converged and fit.chi2 < fit.dof + 6.0 * sd


def best_fit(
    records: Sequence[BandData], sigma_v: FloatArray, starts: Sequence[FloatArray], prior: MismatchPrior | None = None
) -> Fit | None:
    """The best fit from the ``starts`` (12,), tried in order until one explains the band; sigma (S,) [V], ``maximise``."""
    best: Fit | None = None
    for start in starts:
        try:
            fit = maximise(records, sigma_v, start, prior)
        except (np.linalg.LinAlgError, ArithmeticError, ValueError):
            continue
        if not np.all(np.isfinite(fit.x)) or not np.all(np.isfinite(fit.covariance)):
            continue
        if best is None or _rank(fit) > _rank(best):
            best = fit
        if explains(best):
            break
    return best


def model_volts(
    x: FloatArray, drive_v: FloatArray, instrument: Instrument, drive_lanes: Lanes | None = None
) -> FloatArray:
    """Pick-off volts (N, 2) [V] after the anti-alias filter, of parameters x (12,) or (14,) under a drive (N, 2) [V].

    ``drive_lanes`` is the drive as the modal bank takes it, where that is known already.
    """
    poles, residues = modes_at(x)
    bank = behind_filter(Modes(poles[None], residues[None]), instrument.antialias)
    return respond(bank, drive_v, instrument.sample_rate_hz, instrument.hold, drive_lanes)[0]


def identify_device(
    fit_records: Sequence[FitRecord],
    noise: NoiseSpectrum,
    instrument: Instrument,
    settings: IdentificationSettings,
    sampler: SamplerSettings,
    gate: Gate,
    rate: RateSettings,
    seed: np.random.SeedSequence,
) -> DeviceResult:
    """Identify one device from its fit records.

    Parameters
    ----------
    fit_records : at least one; at rest before the first sample, two drives and two senses.
    noise : spectrum of the noise of the silence, two channels.
    instrument, settings, sampler, gate, rate : see their classes.
    seed : random stream of this device.

    Returns
    -------
    A result in every case; a failure is reported as its status, not as an exception.
    """
    fitted = fit_device(fit_records, noise, instrument, settings, sampler, gate, rate, seed)
    (result,) = results_of([fitted])
    if isinstance(result, Exception):
        raise result
    return result


def fit_device(
    fit_records: Sequence[FitRecord],
    noise: NoiseSpectrum,
    instrument: Instrument,
    settings: IdentificationSettings,
    sampler: SamplerSettings,
    gate: Gate,
    rate: RateSettings,
    seed: np.random.SeedSequence,
) -> Fitted | DeviceResult:
    """The fit and the posterior of one device, with the parameters of :func:`identify_device`; its result if it failed."""
    columns: dict[str, Value] = {}
    found: list[RouteResult] = []
    reason = "no record drives both electrodes"
    for item in fit_records:
        if found or not _drives_all(item.band):
            continue
        try:
            found.append(
                identify_record(
                    item.record,
                    instrument,
                    settings.order,
                    (settings.low_hz, settings.high_hz),
                    settings.window_s,
                    filtered_drive_v=item.filtered_drive_v,
                )
            )
        except IdentificationError as error:
            reason = error.what
    if found:
        columns |= _route_columns(found[0])
    sigma_v = noise.sigma_v
    data = [
        BandData(i.band, i.band.transform(i.record.sense_v), i.nuisance, band_noise(noise, i.band)) for i in fit_records
    ]
    prior = settings.mismatch
    fit = best_fit(data, sigma_v, _starts(found), prior)
    if fit is None or not explains(fit):
        # The spectra still show the modes of a device with a Q too low for the ARX model.
        second = best_fit(data, sigma_v, _spectral_starts(fit_records, sigma_v, instrument, settings), prior)
        fit = second if second is not None and (fit is None or _rank(second) > _rank(fit)) else fit
    if fit is None or not fit.converged:
        why = "the likelihood has no maximum near any start; check hold and antialias in campaign.toml"
        return failed_result(why if found else f"{why}; the paper's route: {reason}", columns)
    records = [i.record for i in fit_records]
    if any(record.good is not None for record in records):
        fit, records, data = refilled_fit(
            fit, records, data, sigma_v, lambda x, v: model_volts(x, v, instrument), prior
        )
    models = [model_volts(fit.x, i.record.drive_v, instrument, i.drive_lanes) for i in fit_records]
    quality = full_band_quality(records, models, noise, settings.line_hz)
    if quality.louder:
        quality, data = with_dependent_noise(quality, data, records, models, noise, settings.line_hz)
        if quality.dependent is not None:
            fit = best_fit(data, sigma_v, [fit.x], prior) or fit
    try:
        posterior = sample(fit, sampler, seed)
    except np.linalg.LinAlgError:
        return failed_result(UNDETERMINED, columns)
    louds = [loud_samples(model_v) for model_v in models]
    scoring = Scoring(fit, data, louds, noise, instrument, rate, prior, settings.line_hz)
    return Fitted(columns, scoring, posterior, quality, sampler, gate, seed)
