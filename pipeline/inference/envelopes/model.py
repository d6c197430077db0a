"""A model of amplitudes against time at given parameters: the slow flow of the mode, its free state, and the detector.

    A = E|a + noise| with the floor of the record,    phi = phi_0 + int (W - w_r) dt,    f = W / 2 pi

The amplitude a_0 and the phase phi_0 at the first row are fitted to each record at every parameter (they are free).

Shapes: N rows, S senses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...device.model import Model
from ...errors import ConfigError
from ...experiment.envelopes import EnvelopeRecord, mean_amplitude
from ...experiment.forward.envelopes import SlowFlow, decay, flow_at, mode_near, slow_flow
from ...experiment.forward.system import Conditions, assemble
from ...experiment.instrument import Instrument
from ...experiment.noise.envelopes import EnvelopeNoise

#: Steps of the free amplitude, its largest change in one step [ln], and when it counts as settled.
_ITERATIONS, _LARGEST, _SETTLED = 30, 0.5, 1e-9
#: Step after which the slope is kept.
_CLOSE = 1e-4
#: Amplitudes of the table beyond those measured, as factors.
_BELOW, _ABOVE = 30.0, 4.0


def floor_name(record: int, sense: int) -> str:
    """Name of the noise floor [V] of a record, both counted from 0."""
    return f"floor_r{record + 1}_s{sense + 1}"


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a model predicts: amplitude_v (N, S), phase_rad (N, S) or ``None``, frequency_hz (N,) or ``None``, rate (N,) [1/s]."""

    amplitude_v: FloatArray
    phase_rad: FloatArray | None
    frequency_hz: FloatArray
    rate: FloatArray


@dataclass(frozen=True, eq=False)
class EnvelopeModel:
    """The records as a function of parameters.

    Parameters
    ----------
    model : plant and effects.
    records, noise : the records and the sd of their rows.
    fitted : for each record (N,) the rows that determine its free state.
    instrument, angular_gain : of the campaign.
    even : parameters whose sign the records do not show; ``values`` hold their squares.
    """

    model: Model
    records: tuple[EnvelopeRecord, ...]
    noise: tuple[EnvelopeNoise, ...]
    fitted: tuple[BoolArray, ...]
    instrument: Instrument
    angular_gain: float | None = None
    even: frozenset[str] = frozenset()
    _states: dict[int, float] = field(default_factory=dict)

    def predict(self, values: Mapping[str, float]) -> tuple[Predicted, ...]:
        """Every record; raises ConfigError for parameters that no device can have, and for motion that does not decay."""
        # Sizes that no device has overflow; what follows from them is refused.
        with np.errstate(all="ignore"):
            return tuple(self._record(values, k) for k in range(len(self.records)))

    def flow(self, values: Mapping[str, float], k: int) -> SlowFlow:
        """The slow flow of record ``k`` over the amplitudes that it shows."""
        record = self.records[k]
        own = {
            name: float(np.sqrt(max(value, 0.0))) if name in self.even else value
            for name, value in values.items()
            if name in self.model.by_name
        }
        bias = self.instrument.bias_v
        known = record.rate_dps is not None and (record.rate_dps == 0.0 or self.angular_gain is not None)
        rate = float(np.deg2rad(record.rate_dps or 0.0)) * (self.angular_gain or 0.0)
        conditions = Conditions(bias if record.bias_v is None else record.bias_v, bias, rate if known else None)
        system = assemble(self.model, self.model.complete(own), self.instrument, conditions)
        mode = mode_near(system, record.about_hz)
        linear = flow_at(replace(system, forces=(), senses=()), mode, np.ones(1), np.zeros(1))[2][0]
        size = record.amplitude_v.max(axis=0)
        loud = int(np.argmax(size))
        if not linear[loud] > 0.0:
            raise ConfigError("the pick-off does not show the mode", next_step="check the plant")
        low = max(float(record.amplitude_v[:, loud].min()), 1e-4 * float(size[loud]))
        lowest, highest = low / _BELOW / linear[loud], _ABOVE * size[loud] / linear[loud]
        return slow_flow(system, mode, lowest, highest, float(record.time_s[-1] - record.time_s[0]))

    def _record(self, values: Mapping[str, float], k: int) -> Predicted:
        record, noise, rows = self.records[k], self.noise[k], self.fitted[k]
        flow = self.flow(values, k)
        measured = record.amplitude_v
        floors = [values.get(floor_name(k, s), 0.0) for s in range(measured.shape[1])]
        turn = None if record.tuned_hz is None else 2.0 * np.pi * record.tuned_hz
        seen = None if noise.phase_rad is None else np.isfinite(noise.phase_rad) & rows[:, None]

        def at(log_a: float) -> tuple[Predicted, FloatArray]:
            tone, phase, rate, omega = decay(flow, log_a, record.time_s)
            off = np.zeros_like(omega) if turn is None else omega - turn
            lag = (1.0 + (rate + 1.0j * off) * record.time_constant_s) ** record.poles
            tone = tone / np.abs(lag)[:, None]
            means = [mean_amplitude(a, s, record.averages) for a, s in zip(tone.T, floors)]
            amplitude = np.stack(means, axis=1)
            left = ((measured - amplitude) / noise.amplitude_v)[rows].reshape(-1)
            turned = None
            if record.phase_rad is not None and seen is not None and noise.phase_rad is not None:
                own = phase - (turn or 0.0) * (record.time_s - record.time_s[0]) - np.angle(lag)
                turned = np.repeat(own[:, None], measured.shape[1], axis=1)
                weight = np.where(seen, 1.0 / noise.phase_rad**2, 0.0)
                rest = np.where(seen, record.phase_rad - turned, 0.0)
                turned = turned + np.sum(weight * rest, axis=0) / np.maximum(np.sum(weight, axis=0), 1e-300)
                left = np.concatenate([left, ((record.phase_rad - turned) / noise.phase_rad)[seen]])
            found = omega / (2.0 * np.pi)
            if record.frequency_hz is not None and noise.frequency_hz is not None:
                clear = np.isfinite(noise.frequency_hz) & rows
                left = np.concatenate([left, ((record.frequency_hz - found) / noise.frequency_hz)[clear]])
            return Predicted(amplitude, turned, found, rate), left

        log_a = self._states.get(k, self._first(flow, k))
        best, left = at(log_a)
        slope, moved = np.zeros(0), np.inf
        for _ in range(_ITERATIONS):
            if abs(moved) > _CLOSE:
                slope = (at(log_a + 1e-6)[1] - at(log_a - 1e-6)[1]) / 2e-6
            step = -float(slope @ left) / max(float(slope @ slope), 1e-300)
            step = float(np.clip(step, -_LARGEST, _LARGEST))
            if abs(step) < _SETTLED:
                break
            for _ in range(8):
                trial, rest = at(log_a + step)
                if float(rest @ rest) <= float(left @ left):
                    break
                step *= 0.5
            else:
                break
            log_a, best, left, moved = log_a + step, trial, rest, step
        if not np.all(np.isfinite(best.amplitude_v)):
            raise ConfigError("the motion has no envelope", next_step="check the size of the effects")
        self._states[k] = log_a
        return best

    def _first(self, flow: SlowFlow, k: int) -> float:
        """ln a at which the first rows have the measured amplitude."""
        size = float(np.median(self.records[k].amplitude_v[:3].max(axis=1)))
        tone = flow.tone[0].max(axis=1) * np.exp(flow.log_a)
        if not np.all(tone > 0.0):
            raise ConfigError("the pick-off does not show the mode", next_step="check the size of the effects")
        return float(np.interp(np.log(size), np.log(tone), flow.log_a))
