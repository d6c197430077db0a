"""Estimates of a streaming identification: noise, start values, and the maximum-likelihood snapshot so far.

    lattice at any moment --> ARX model --> three modes --> start --> maximum likelihood of the samples so far

Shapes: N samples so far, two drives and two senses [V]; cartesian parameters (12,).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...errors import MeasurementError
from ...experiment.instrument import Instrument
from ...experiment.noise.lines import hum_line
from ...experiment.noise.spectrum import NoiseSpectrum, noise_spectrum, white_spectrum
from ...experiment.record import Record
from ...identification.arx import ArxModel
from ...identification.failure import IdentificationError
from ...identification.lattice import arx_of
from ...identification.modes import modes_of, to_continuous
from ...identification.route import RouteResult, route_from_modes
from ..estimate import RateSettings
from ..gate import Gate
from ..general.starts import gyro_start
from .compressed import BandData, nuisance_basis
from .fit import start_from_modes
from .inband import make_band
from .snapshot import Snapshot, snapshot
from .stream import Stream, StreamSettings
from .whitening import band_noise

#: Shortest silence from which a noise level is taken [s].
_LEAST_SILENCE_S = 0.1
#: Degrees of freedom of a noise level that is given, not measured.
_GIVEN = 10**9


def noise_of(stream: Stream) -> tuple[NoiseSpectrum, float | None]:
    """Spectrum of the noise and mains frequency [Hz]: those of the settings, else from the samples before the drive.

    Raises
    ------
    MeasurementError : the settings give no noise, and the silence is too short.
    """
    settings, instrument = stream.settings, stream.instrument
    if settings.noise is not None:
        return settings.noise, settings.line_hz
    if settings.sigma_v is not None:
        sigma_v = np.array(settings.sigma_v, dtype=np.float64)
        return white_spectrum(sigma_v, instrument.sample_rate_hz, _GIVEN), settings.line_hz
    count = sum(block.shape[0] for block in stream.silent_v)
    if count >= _LEAST_SILENCE_S * instrument.sample_rate_hz:
        silent = np.concatenate(stream.silent_v)
        line_hz = settings.line_hz or hum_line(silent, instrument.sample_rate_hz)
        noise = noise_spectrum(silent, instrument.sample_rate_hz, line_hz, instrument.adc)
        if np.all(noise.sigma_v > 0.0):
            return noise, line_hz
    raise MeasurementError(
        "the noise is unknown: the silence before the drive is too short",
        value=f"{count / instrument.sample_rate_hz:.3f} s",
        allowed=f"at least {_LEAST_SILENCE_S} s of silence with noise, a given noise level, or a campaign with a silent record",
        next_step="give --sigma-v in volts, or --campaign FOLDER",
    )


def route_of(model: ArxModel, instrument: Instrument, settings: StreamSettings) -> RouteResult:
    """The paper's route from an ARX model of the bandpassed data.

    Raises
    ------
    IdentificationError : the model does not have two rocking modes and one up-down mode.
    """
    band = (settings.low_hz, settings.high_hz)
    modes = modes_of(model, instrument.sample_rate_hz, band)
    return route_from_modes(to_continuous(modes, instrument.sample_rate_hz, instrument.hold), instrument.antialias)


def starts_of(
    routes: Sequence[RouteResult], record: Record, instrument: Instrument, settings: StreamSettings, sigma_v: FloatArray
) -> list[FloatArray]:
    """Cartesian starts (12,): modes of each route with and without damping anisotropy, and of the spectrum; sigma (S,) [V]."""
    found: list[FloatArray] = []
    for route in routes:
        start = start_from_modes(route.poles, route.residues)
        flat = start.copy()
        flat[4:6] = 0.0
        found += [start, flat]
    with contextlib.suppress(np.linalg.LinAlgError, ArithmeticError, ValueError):
        found.append(gyro_start([record], instrument, sigma_v, settings.low_hz, settings.high_hz))
    return [start for start in found if np.all(np.isfinite(start))]


def lattice_route(stream: Stream, order: int | None = None) -> RouteResult | None:
    """The paper's route from the present lattice, at any order up to its own; ``None`` where its three modes are not found."""
    if stream.lattice is None:
        return None
    try:
        return route_of(arx_of(stream.lattice, order), stream.instrument, stream.settings)
    except (IdentificationError, np.linalg.LinAlgError):
        return None


def start_orders(order: int) -> tuple[int, ...]:
    """Orders of the models whose modes start a fit; with little data a lower order is better."""
    return order, order // 2, order // 4


def estimate(
    stream: Stream,
    noise: tuple[NoiseSpectrum, float | None],
    previous: FloatArray | None,
    rate: RateSettings,
    gate: Gate,
    seed: np.random.SeedSequence,
) -> tuple[Snapshot, RouteResult | None]:
    """The snapshot from the samples so far, and the paper's route from the lattice.

    Parameters
    ----------
    stream : the state; the drive has started.
    noise : spectrum and mains frequency [Hz], of :func:`noise_of`; constant once the drive has started.
    previous : cartesian point (12,) of an earlier snapshot of this stream, if any.
    rate, gate : as for ``identify_device``.
    seed : stream of the posterior draws.

    Raises
    ------
    MeasurementError : the drive has not started.
    """
    if not stream.driven:
        raise MeasurementError(
            "the drive has not started",
            value=f"{stream.samples} samples of silence",
            allowed="a record in which both drives act",
            next_step="feed more of the record",
        )
    spectrum, line_hz = noise
    sigma_v = spectrum.sigma_v
    drive, sense = np.concatenate(stream.drive_v), np.concatenate(stream.sense_v)
    instrument, settings = stream.instrument, stream.settings
    band = make_band(drive, instrument, settings.low_hz, settings.high_hz)
    data = BandData(band, band.transform(sense), nuisance_basis(band, line_hz), band_noise(spectrum, band))
    route = lattice_route(stream)
    record = Record("so far", instrument.sample_rate_hz, drive, sense)

    def starts() -> Sequence[FloatArray]:
        lower = [lattice_route(stream, order) for order in start_orders(settings.order)[1:]]
        routes = [one for one in (route, *lower) if one is not None]
        return starts_of(routes, record, instrument, settings, sigma_v)

    return snapshot(data, sigma_v, previous, starts, rate, gate, seed, settings.mismatch), route
