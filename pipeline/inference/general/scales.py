"""The scale of a campaign, from its records alone, and the band of its rows.

    hz        median frequency of the energy of the senses in the driven band, over 535 Hz            in steps of 2
    sense     largest sample of the senses, over 2 V                                                  in steps of 16
    transfer  sense over the largest drive sample                                                     in steps of 16
    duration  of the longest record, over 3 s                                                         in steps of 4
    motion    sense (2 pi 535 Hz hz)^(1 - m): the senses are the m-th derivative of the motion         in steps of 2

A mode that an effect adds lies above three quarters of the lowest driven frequency, because drives excite it by its flank, and
is at least as high as the frequency resolution.  Rows end at the octave of Nyquist above the third harmonic of the drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import rfft

from ...device.model import Model
from ...device.plant import SENSES
from ...device.scale import Scale
from ...errors import ConfigError, MeasurementError
from ...experiment.instrument import Instrument
from ...experiment.record import Campaign, Record
from .starts import excited_band

#: Frequency [Hz], peak of the senses [V] and duration [s] in whose step the gyro of the paper lies.
_HZ, _VOLTS, _SECONDS = 535.0, 2.0, 3.0
#: Lowest frequency of a mode over the lowest driven one, and over the frequency resolution.
_BELOW, _CYCLES = 0.75, 2.0
#: Highest frequency of a mode over the sample rate: beyond Nyquist it stands for a stray capacitance.
_ABOVE = 10.0
#: Harmonics of the drives that the rows hold.
_HARMONICS = 3.0


def check_pickoff(model: Model, instrument: Instrument) -> None:
    """Raise ConfigError where both the plant and the instrument integrate: a displacement would be integrated again."""
    if model.plant.kind == "modal" and model.plant.sense != "velocity" and instrument.pickoff == "displacement":
        raise ConfigError(
            "the model and the campaign both state what the pick-offs sense",
            value=f'sense = "{model.plant.sense}" in the model, pickoff = "displacement" under [device]',
            allowed='pickoff = "displacement" beside sense = "velocity", the quantity before the charge amplifier',
            next_step="remove pickoff from [device] of campaign.toml",
        )


def scaled_to(model: Model, campaign: Campaign) -> Model:
    """The model at the scale of the campaign, unless it has one already; a gyro has the electrodes of the campaign.

    Raises
    ------
    ConfigError : as of ``check_pickoff``.
    """
    check_pickoff(model, campaign.instrument)
    if model.plant.scale is not None:
        return model
    if model.plant.kind == "gyro":
        frame = campaign.frame
        model = replace(model, plant=replace(model.plant, frame_deg=frame.angles_deg, updown=frame.updown))
    sense = "velocity" if model.plant.kind == "gyro" else model.plant.sense
    scale = scale_of(campaign.with_role("fit"), campaign.instrument, SENSES.index(sense))
    return replace(model, plant=replace(model.plant, scale=scale))


def scale_of(records: Sequence[Record], instrument: Instrument, derivative: int) -> Scale:
    """The scale of fit records whose plant senses the m-th ``derivative`` of its motion, before a filter that integrates."""
    low_hz, high_hz = _band(records)
    seconds = max(record.duration_s for record in records)
    hz = _step(_median_hz(records, low_hz, high_hz) / _HZ, 2.0)
    peak = max(float(np.ptp(record.sense_v, axis=0).max(initial=0.0)) / 2.0 for record in records)
    drive = max(float(np.max(np.abs(record.drive_v), initial=0.0)) for record in records)
    sense = _step(peak / _VOLTS, 16.0)
    m = derivative - (1 if instrument.pickoff == "displacement" else 0)
    motion = sense * (_step(2.0 * np.pi * _HZ, 2.0) * hz) ** (1 - m)
    lowest = _one_digit(max(_BELOW * low_hz, _CYCLES / seconds))
    return Scale(
        hz,
        motion,
        sense,
        _step(peak / (_VOLTS * drive), 16.0) if drive > 0.0 else 1.0,
        _step(seconds / _SECONDS, 4.0),
        (lowest, _ABOVE * records[0].sample_rate_hz),
    )


def top_hz(records: Sequence[Record]) -> float:
    """Upper end of the rows [Hz]: Nyquist, or that over 2, 4, 8, ... above the third harmonic of the drives."""
    nyquist = 0.5 * records[0].sample_rate_hz
    high_hz = _band(records)[1]
    return float(nyquist / 2.0 ** max(0.0, np.floor(np.log2(nyquist / (_HARMONICS * high_hz)))))


def _band(records: Sequence[Record]) -> tuple[float, float]:
    """The band [Hz] in which the records move; all of it up to Nyquist where none does."""
    try:
        return excited_band(records)
    except MeasurementError:
        return 0.0, 0.5 * records[0].sample_rate_hz


def _median_hz(records: Sequence[Record], low_hz: float, high_hz: float) -> float:
    """Frequency [Hz] below which half of the energy of the senses in the band lies."""
    edges = np.linspace(low_hz, high_hz, 4097)
    energy = np.zeros(edges.size - 1)
    for record in records:
        f = np.arange(1, record.sense_v.shape[0] // 2 + 1) * record.sample_rate_hz / record.sense_v.shape[0]
        power = np.sum(np.abs(rfft(record.sense_v - record.sense_v.mean(axis=0), axis=0)[1:]) ** 2, axis=1)
        energy += np.histogram(f, edges, weights=power)[0]
    total = np.cumsum(energy)
    return float(edges[1 + np.searchsorted(total, 0.5 * total[-1])]) if total[-1] > 0.0 else 0.5 * (low_hz + high_hz)


def _step(ratio: float, base: float) -> float:
    """The power of ``base`` nearest to a positive ratio; 1 for zero."""
    return float(base ** np.round(np.log(ratio) / np.log(base))) if ratio > 0.0 else 1.0


def _one_digit(value: float) -> float:
    """A positive number rounded to one digit."""
    unit = 10.0 ** np.floor(np.log10(value))
    return float(np.round(value / unit) * unit)
