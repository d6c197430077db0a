"""State of a streaming identification: a record that grows is filtered and enters the lattice block by block.

    v, S --> bandpass --> lattice filter (identification.lattice)

The lattice starts with the drive.  Its ridge, a small share of the energy of each channel, is set from the first tenth of a
second of the drive.  The record itself is kept for the likelihood (``stream_estimate``).

Shapes: blocks (n, D), (n, S) [V] of any length, D = S = 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...errors import MeasurementError
from ...experiment.instrument import Instrument
from ...experiment.noise.spectrum import NoiseSpectrum
from ...identification.bandpass import bandpass_sections
from ...identification.lattice import Lattice, advance, start_lattice
from .mismatch import BROAD, MismatchPrior

#: The ridge relative to the energy of this number of samples: the paper's two seconds at 10 kHz.
_RIDGE, _RIDGE_SAMPLES = 1e-12, 20_000
#: Duration of the drive from which the ridge is set [s].
_SETTLE_S = 0.1


@dataclass(frozen=True)
class StreamSettings:
    """Settings of a streaming identification.

    Parameters
    ----------
    order : of the lattice.
    low_hz, high_hz : band of the likelihood [Hz].
    first_s, every_s : time of the first estimate after the start of the drive, and the interval of further ones [s].  A
        multiple of 0.1 s contains whole cycles of 50 and 60 Hz, so that hum stays on its bins.
    sigma_v : noise (2,) [V]; ``None`` where it is measured in the silence before the drive.
    line_hz : mains frequency [Hz]; ``None`` where it is unknown.
    noise : spectrum of the noise where it was measured before; it replaces ``sigma_v``.
    mismatch : prior of the electrode mismatches; ``None``: they are not in the model.
    """

    order: int = 40
    low_hz: float = 400.0
    high_hz: float = 700.0
    first_s: float = 0.3
    every_s: float = 0.1
    sigma_v: tuple[float, ...] | None = None
    line_hz: float | None = None
    noise: NoiseSpectrum | None = None
    mismatch: MismatchPrior | None = BROAD


@dataclass(frozen=True, eq=False)
class Stream:
    """The state after ``samples`` samples; :func:`feed` returns the next one.

    Parameters
    ----------
    instrument, settings : known before the first sample.
    samples, driven : numbers of samples, in all and since the sample before the drive started.
    drive_v, sense_v : blocks (n, 2) [V] since the sample before the drive started.
    silent_v : blocks (n, 2) [V] of the senses before that.
    filtered : bandpassed blocks (n, S + D) that wait for the lattice to start.
    delay : (4, 2, S + D) state of the bandpass.
    last_silent : the last silent sample (1, 2) [V]; with a first-order hold the drive acts from this sample on.
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
    last_silent: FloatArray | None = None
    lattice: Lattice | None = None

    @property
    def due(self) -> int:
        """Samples from the start of the drive at which the next estimate is due."""
        rate = self.instrument.sample_rate_hz
        first, every = max(1, round(self.settings.first_s * rate)), max(1, round(self.settings.every_s * rate))
        return first if self.driven < first else first + every * ((self.driven - first) // every + 1)


def start_stream(instrument: Instrument, settings: StreamSettings) -> Stream:
    """The state before the first sample; the device is at rest.

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
    if stream.last_silent is not None:
        drive_v = np.concatenate([np.zeros((1, 2)), drive_v])
        sense_v = np.concatenate([stream.last_silent, sense_v])
    quiet = 0 if stream.driven else _quiet(drive_v)
    silent = quiet == drive_v.shape[0]
    last_silent = sense_v[-1:] if silent else None
    if silent:
        quiet -= 1
        drive_v, sense_v = drive_v[:-1], sense_v[:-1]
        if not quiet:
            return replace(stream, samples=samples, last_silent=last_silent)
    from scipy.signal import sosfilt  # loading it takes 0.7 s, and only streams need it

    sections = bandpass_sections(stream.instrument.sample_rate_hz, stream.settings.low_hz, stream.settings.high_hz)
    both, delay = sosfilt(np.array(sections), np.concatenate([sense_v, drive_v], axis=1), axis=0, zi=stream.delay)
    after = replace(stream, samples=samples, delay=np.asarray(delay), last_silent=last_silent)
    if quiet:
        after = replace(after, silent_v=(*stream.silent_v, sense_v[:quiet]))
    if silent:
        return after
    after = replace(
        after,
        driven=stream.driven + drive_v.shape[0] - quiet,
        drive_v=(*stream.drive_v, drive_v[quiet:]),
        sense_v=(*stream.sense_v, sense_v[quiet:]),
    )
    return _through_lattice(after, np.asarray(both[quiet:]))


def _quiet(drive_v: FloatArray) -> int:
    """Number of samples before the last silent one; all samples (n, 2) if the drive does not start."""
    moving = np.flatnonzero(np.any(drive_v != 0.0, axis=1))
    return max(int(moving[0]) - 1, 0) if moving.size else drive_v.shape[0]


def steps(stream: Stream, drive_v: FloatArray, sense_v: FloatArray) -> Iterator[tuple[Stream, bool]]:
    """Feed a block, drive (n, 2) and sense (n, 2) [V], in pieces that end where an estimate is due.

    Yields the state after each piece, and whether an estimate is due there.

    Raises
    ------
    MeasurementError : as :func:`feed`.
    """
    first = 0
    while first < drive_v.shape[0]:
        quiet = 0 if stream.driven else _quiet(drive_v[first:])
        repeated = 0 if stream.last_silent is None else 1
        last = first + (quiet or stream.due - stream.driven - repeated)
        due = stream.due
        stream = feed(stream, drive_v[first:last], sense_v[first:last])
        yield stream, stream.driven == due
        first = last


def _through_lattice(stream: Stream, filtered: FloatArray) -> Stream:
    """The state after bandpassed samples (n, S + D) have entered the lattice, or wait for it to start."""
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
            # A channel that is still zero has no scale for its ridge.
            return replace(stream, filtered=waiting)
        lattice = start_lattice(2, 2, stream.settings.order, _RIDGE * _RIDGE_SAMPLES * energy)
    block = np.concatenate(waiting)
    return replace(stream, filtered=(), lattice=advance(lattice, block[:, :2], block[:, 2:]))
