"""Streaming identification: a record as it grows, sample by sample through the lattice.

    v, S --(12)--> lattice filter --> ARX model of any moment --> three modes --> start --> maximum likelihood so far

The noise is taken from the samples before the drive starts, or given.  The lattice starts with the drive: its ridge, a
small share of the energy that each channel will have, is set from the first tenth of a second of it.

Shapes: blocks (n, D), (n, S) [V] of any length; the state never looks back further than the lattice does, and the record
is kept for the likelihood.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import sosfilt

from ...arrays import FloatArray
from ...errors import MeasurementError
from ...experiment.instrument import Instrument
from ...experiment.noise.lines import hum_line, silent_sigma
from ...experiment.record import Record
from ...identification.arx import ArxModel
from ...identification.bandpass import bandpass_sections
from ...identification.failure import IdentificationError
from ...identification.lattice import Lattice, advance, arx_of, start_lattice
from ...identification.modes import modes_of, to_continuous
from ...identification.route import RouteResult, route_from_modes
from ..estimate import RateSettings
from ..gate import Gate
from ..general.starts import gyro_start
from .compressed import BandData, nuisance_basis
from .fit import start_from_modes
from .inband import make_band
from .snapshot import Snapshot, snapshot

_RIDGE = 1e-12
#: Samples whose energy the ridge is relative to: the paper's two seconds at 10 kHz.
_RIDGE_SAMPLES = 20_000
_SETTLE_S = 0.1
#: Least silence from which a noise level is taken [s].
_LEAST_SILENCE_S = 0.1


@dataclass(frozen=True)
class StreamSettings:
    """Order of the lattice, band of the likelihood, noise (2,) [V] and hum, where they are known beforehand.

    ``first_s`` after the start of the drive and then every ``every_s`` the data so far are judged.  A multiple of 0.1 s
    holds whole cycles of 50 and of 60 Hz, so that hum stays on its bins.
    """

    order: int = 40
    low_hz: float = 400.0
    high_hz: float = 700.0
    first_s: float = 0.3
    every_s: float = 0.1
    sigma_v: tuple[float, ...] | None = None
    line_hz: float | None = None


@dataclass(frozen=True, eq=False)
class Stream:
    """The state after ``samples`` samples; :func:`feed` returns the next one.

    drive_v, sense_v : blocks since the sample before the drive started.
    silent_v : blocks of the senses before that.
    filtered : bandpassed blocks (n, S + D) that wait for the lattice to start.
    delay : (4, 2, S + D) state of the bandpass.
    held : the last silent sample (1, 2) [V]: with a first-order hold a drive that follows acts from it on.
    lattice : ``None`` until the drive has acted for a tenth of a second.
    """

    instrument: Instrument
    settings: StreamSettings
    samples: int
    driven: int
    drive_v: tuple[FloatArray, ...]
    sense_v: tuple[FloatArray, ...]
    silent_v: tuple[FloatArray, ...]
    filtered: tuple[FloatArray, ...]
    delay: FloatArray
    held: FloatArray | None = None
    lattice: Lattice | None = None

    @property
    def due(self) -> int:
        """Samples from the start of the drive at which the next estimate is due."""
        rate = self.instrument.sample_rate_hz
        first, every = max(1, round(self.settings.first_s * rate)), max(1, round(self.settings.every_s * rate))
        return first if self.driven < first else first + every * ((self.driven - first) // every + 1)


def start_stream(instrument: Instrument, settings: StreamSettings) -> Stream:
    """The state before the first sample, two drives and two senses at rest.

    Raises
    ------
    IdentificationError : the band does not fit the sample rate.
    """
    sections = bandpass_sections(instrument.sample_rate_hz, settings.low_hz, settings.high_hz)
    return Stream(instrument, settings, 0, 0, (), (), (), (), np.zeros((sections.shape[0], 2, 4)))


def feed(stream: Stream, drive_v: FloatArray, sense_v: FloatArray) -> Stream:
    """The state after a further block, drive (n, 2) and sense (n, 2) [V].

    Raises
    ------
    MeasurementError : not two drives and two senses, or a value that is not finite.
    """
    if drive_v.shape[1:] != (2,) or sense_v.shape[1:] != (2,):
        raise MeasurementError(
            "streaming identification needs two drives and two senses",
            value=(drive_v.shape[1:], sense_v.shape[1:]),
            allowed="drive1_V, drive2_V, sense1_V, sense2_V",
            next_step="identify the whole record instead, without --stream",
        )
    if not drive_v.shape[0]:
        return stream
    samples = stream.samples + drive_v.shape[0]
    if stream.held is not None:
        drive_v = np.concatenate([np.zeros((1, 2)), drive_v])
        sense_v = np.concatenate([stream.held, sense_v])
    quiet = 0 if stream.driven else _quiet(drive_v)
    silent = quiet == drive_v.shape[0]
    held = sense_v[-1:] if silent else None
    if silent:
        quiet -= 1
        drive_v, sense_v = drive_v[:-1], sense_v[:-1]
        if not quiet:
            return replace(stream, samples=samples, held=held)
    sections = bandpass_sections(stream.instrument.sample_rate_hz, stream.settings.low_hz, stream.settings.high_hz)
    both, delay = sosfilt(np.array(sections), np.concatenate([sense_v, drive_v], axis=1), axis=0, zi=stream.delay)
    moved = replace(stream, samples=samples, delay=np.asarray(delay), held=held)
    if quiet:
        moved = replace(moved, silent_v=(*stream.silent_v, sense_v[:quiet]))
    if silent:
        return moved
    moved = replace(
        moved,
        driven=stream.driven + drive_v.shape[0] - quiet,
        drive_v=(*stream.drive_v, drive_v[quiet:]),
        sense_v=(*stream.sense_v, sense_v[quiet:]),
    )
    return _through_lattice(moved, np.asarray(both[quiet:]))


def _quiet(drive_v: FloatArray) -> int:
    """Samples before the last one before the drive starts; all of them where it does not."""
    moving = np.flatnonzero(np.any(drive_v != 0.0, axis=1))
    return max(int(moving[0]) - 1, 0) if moving.size else drive_v.shape[0]


def steps(stream: Stream, drive_v: FloatArray, sense_v: FloatArray) -> Iterator[tuple[Stream, bool]]:
    """The states after the pieces of a block that end where an estimate is due; whether one is.

    Raises
    ------
    MeasurementError : as :func:`feed`.
    """
    first = 0
    while first < drive_v.shape[0]:
        quiet = 0 if stream.driven else _quiet(drive_v[first:])
        held = 0 if stream.held is None else 1
        last = first + (quiet or stream.due - stream.driven - held)
        due = stream.due
        stream = feed(stream, drive_v[first:last], sense_v[first:last])
        yield stream, stream.driven == due
        first = last


def _through_lattice(stream: Stream, filtered: FloatArray) -> Stream:
    waiting = (*stream.filtered, filtered)
    lattice = stream.lattice
    if lattice is None:
        settling = round(_SETTLE_S * stream.instrument.sample_rate_hz)
        if stream.driven < settling:
            return replace(stream, filtered=waiting)
        energy = np.mean(np.concatenate(waiting)[:settling] ** 2, axis=0)
        if not np.all(energy > 0.0):
            energy = np.mean(np.concatenate(waiting) ** 2, axis=0)
        if not np.all(energy > 0.0):
            # A drive or a sense that has not moved has no scale yet, and no model either.
            return replace(stream, filtered=waiting)
        lattice = start_lattice(2, 2, stream.settings.order, _RIDGE * _RIDGE_SAMPLES * energy)
    block = np.concatenate(waiting)
    return replace(stream, filtered=(), lattice=advance(lattice, block[:, :2], block[:, 2:]))


def noise_of(stream: Stream) -> tuple[FloatArray, float | None]:
    """sigma (2,) [V] and mains frequency: as given, else from the samples before the drive.

    Raises
    ------
    MeasurementError : neither is there, so the noise is unknown.
    """
    settings, instrument = stream.settings, stream.instrument
    if settings.sigma_v is not None:
        return np.array(settings.sigma_v, dtype=np.float64), settings.line_hz
    count = sum(block.shape[0] for block in stream.silent_v)
    if count >= _LEAST_SILENCE_S * instrument.sample_rate_hz:
        silent = np.concatenate(stream.silent_v)
        line_hz = settings.line_hz or hum_line(silent, instrument.sample_rate_hz)
        sigma = silent_sigma(silent, instrument.sample_rate_hz, line_hz, instrument.adc)
        if np.all(sigma > 0.0):
            return sigma, line_hz
    raise MeasurementError(
        "the noise is unknown: too little silence before the drive starts",
        value=f"{count / instrument.sample_rate_hz:.3f} s",
        allowed=f"{_LEAST_SILENCE_S} s of silence with noise in it, a noise level, or a campaign with a silent record",
        next_step="give --sigma-v in volts, or --campaign FOLDER",
    )


def route_of(model: ArxModel, instrument: Instrument, settings: StreamSettings) -> RouteResult:
    """The paper's route from an ARX model of the bandpassed data.

    Raises
    ------
    IdentificationError : the model does not hold two rocking modes and one up-down mode.
    """
    band = (settings.low_hz, settings.high_hz)
    modes = modes_of(model, instrument.sample_rate_hz, band)
    return route_from_modes(to_continuous(modes, instrument.sample_rate_hz, instrument.hold), instrument.antialias)


def starts_of(
    routes: Sequence[RouteResult], record: Record, instrument: Instrument, settings: StreamSettings, sigma_v: FloatArray
) -> list[FloatArray]:
    """Starting points (12,): modes of each route with and without damping anisotropy, and those of the record's spectrum."""
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
    """The paper's route from the lattice as it stands, at any order up to its own; ``None`` while it holds no three modes."""
    if stream.lattice is None:
        return None
    try:
        return route_of(arx_of(stream.lattice, order), stream.instrument, stream.settings)
    except (IdentificationError, np.linalg.LinAlgError):
        return None


def start_orders(order: int) -> tuple[int, ...]:
    """Orders whose modes may start a fit: with little data a lower one than the wanted is the better."""
    return order, order // 2, order // 4


def estimate(
    stream: Stream,
    noise: tuple[FloatArray, float | None],
    previous: FloatArray | None,
    rate: RateSettings,
    gate: Gate,
    seed: np.random.SeedSequence,
) -> tuple[Snapshot, RouteResult | None]:
    """What the data so far say, and the route of the lattice beside it.

    Parameters
    ----------
    stream : the state; the drive has started.
    noise : of :func:`noise_of`; it does not change once the drive has started.
    previous : fit of an earlier snapshot of this stream (12,), if any: the next is near it.
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
    sigma_v, line_hz = noise
    drive, sense = np.concatenate(stream.drive_v), np.concatenate(stream.sense_v)
    instrument, settings = stream.instrument, stream.settings
    band = make_band(drive, instrument, settings.low_hz, settings.high_hz)
    data = BandData(band, band.transform(sense), nuisance_basis(band, line_hz))
    route = lattice_route(stream)
    record = Record("so far", instrument.sample_rate_hz, drive, sense)

    def starts() -> Sequence[FloatArray]:
        lower = [lattice_route(stream, order) for order in start_orders(settings.order)[1:]]
        routes = [one for one in (route, *lower) if one is not None]
        return starts_of(routes, record, instrument, settings, sigma_v)

    return snapshot(data, sigma_v, previous, starts, rate, gate, seed), route
