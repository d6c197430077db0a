"""What another sweep, frequency response or decay would show of one effect: a record like a measured one, at another level.

The rows, the noise and the instrument are those of the measured record.  The fit with the effect predicts what would be measured;
the fit without it, whose parameters may follow, is compared with that.  apart, known and snr are defined in
``next_experiment.predicted``.

Shapes: N rows, S senses; P parameters of a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...criticism.announce import announce
from ...criticism.separation import Prediction, fits_to_separate, known_of, snr
from ...errors import UsageError
from ...experiment.envelopes import EnvelopeRecord
from ...experiment.tones import ToneRecord
from ...inference.envelopes.model import EnvelopeModel, Predicted
from ...inference.tones.model import PHASE, ToneModel, differences, offset_names
from ...inference.tones.steps import damping_names, difference_step, lower_bound, slope
from ..envelopes.part import EnvelopePart
from ..tones.part import TonePart
from .problem import JointProblem

T = TypeVar("T")
_Values = Mapping[str, float]


@dataclass(frozen=True)
class Repeat:
    """A record like a measured one.

    Parameters
    ----------
    record : name of the measured one.
    what : "sweep", "frequency response" or "decay".
    first_v : its largest drive, or the largest amplitude of a decay [V].
    scale : factor on all drives, or on the amplitude at the start.
    """

    record: str
    what: str
    first_v: float
    scale: float = 1.0

    @property
    def level_v(self) -> float:
        """Largest drive or amplitude [V]."""
        return self.scale * self.first_v

    @property
    def shape(self) -> str:
        """What is measured, without its level."""
        return f"{self.what} like {self.record}"

    @property
    def words(self) -> str:
        """What is measured, and at which level."""
        return f"{self.shape}, {'from' if self.what == 'decay' else 'at'} {self.level_v:.3g} V"

    def scaled(self, factor: float) -> Repeat:
        """The same at another level."""
        return replace(self, scale=self.scale * factor)


@dataclass(frozen=True, eq=False)
class RepeatedRecord:
    """A record that was not measured, as two fits predict it.

    Parameters
    ----------
    effect : by which the fits differ.
    experiment : the record.
    told : the record as the fit with the effect predicts it.
    without_v : (N, S) prediction of the fit without it: complex amplitudes, or amplitudes of a decay [V].
    residual : (N, S) rms of their difference in each row [sigma].
    apart, known, snr : see ``next_experiment.predicted`` [sigma].
    """

    effect: str
    experiment: Repeat
    told: ToneRecord | EnvelopeRecord
    without_v: ComplexArray | FloatArray
    residual: FloatArray
    apart: float
    known: float
    snr: float


@dataclass(frozen=True, eq=False)
class _RepeatRows:
    """The rows of the new record.

    Parameters
    ----------
    told : the record as the fit with the effect predicts it, and the same as ``whitened`` takes it.
    predict : parameters -> prediction.
    whitened : prediction, or its change -> (N, S, k) [sigma]: what a row shows of each sense; nan for what it does not.
    slopes : parameters, names -> (P,) changes of the prediction.
    """

    told: tuple[ToneRecord | EnvelopeRecord, Any]
    predict: Callable[[_Values], Any]
    whitened: Callable[[Any], FloatArray]
    slopes: Callable[[_Values, Sequence[str]], Sequence[Any]]


def repeats(problem: JointProblem) -> tuple[Repeat, ...]:
    """The measured sweeps, responses and decays, each of which may be measured once more."""
    found = []
    for part in problem.parts:
        if isinstance(part, TonePart):
            for one in part.campaign.records:
                what = "sweep" if one.kind == "sweep" else "frequency response"
                found.append(Repeat(one.name, what, float(one.level_v.max())))
        if isinstance(part, EnvelopePart):
            found += [Repeat(one.name, "decay", float(one.amplitude_v.max())) for one in part.records]
    return tuple(found)


def repeated_record(problem: JointProblem, terms: Sequence[str], effect: str, experiment: Repeat) -> RepeatedRecord:
    """The record of ``experiment`` by the fits with ``terms``, without and with ``effect``.

    Raises
    ------
    NegativeError : one of the fits fails.
    UsageError : no measured record has the name.
    ConfigError : the model has no motion at this level.
    """
    without, fit = fits_to_separate(problem, terms, effect)
    announce(f"predicting the next record with {effect}")
    values, names = problem.values(without), tuple(without.parameters)
    rows = _rows_of(problem, experiment, problem.values(fit))
    record, told = rows.told
    prediction = rows.predict(values)
    s_1, s_0 = rows.whitened(told), rows.whitened(prediction)
    slopes = np.stack([_seen(rows.whitened(one)) for one in rows.slopes(values, names)], axis=1)
    simple = Prediction("without", _seen(s_0), without.chi2, known_of(without), slopes)
    return RepeatedRecord(
        effect=effect,
        experiment=experiment,
        told=record,
        without_v=prediction.amplitude_v if isinstance(prediction, Predicted) else prediction,
        residual=np.sqrt(np.nanmean((s_1 - s_0) ** 2, axis=2)),
        apart=float(np.linalg.norm(_seen(s_1 - s_0))),
        known=float(np.sqrt(max(without.chi2 - fit.chi2, 0.0))),
        snr=snr(Prediction(effect, _seen(s_1), fit.chi2, known_of(fit)), simple),
    )


def _seen(white: FloatArray) -> FloatArray:
    """(N S k,) rows, zero where nothing is shown."""
    return np.nan_to_num(white).reshape(-1)


def _rows_of(problem: JointProblem, experiment: Repeat, values: _Values) -> _RepeatRows:
    """The rows of ``experiment``; a fit with ``values`` says what is measured."""
    for place, part in enumerate(problem.parts):
        sizes, scale = problem.rows.typical(place), experiment.scale
        if isinstance(part, TonePart):
            for k, tones in enumerate(part.campaign.records):
                if tones.name == experiment.record:
                    return _tones(part, k, scale, sizes, values)
        if isinstance(part, EnvelopePart):
            for k, decay in enumerate(part.records):
                if decay.name == experiment.record:
                    return _decay(part, k, scale, sizes, values)
    raise UsageError(
        "no sweep, frequency response or decay has this name",
        value=experiment.record,
        allowed=", ".join(one.record for one in repeats(problem)),
        next_step="choose one of them",
    )


def _tones(part: TonePart, k: int, scale: float, sizes: _Values, values: _Values) -> _RepeatRows:
    record, sd_v = part.campaign.records[k], part.rows.noise.sd_v[k]
    louder = replace(record, drive_v=scale * record.drive_v, sense_v=scale * record.sense_v)
    campaign = replace(part.campaign, records=(louder,), timed=None, envelopes=())
    model = ToneModel(part.full, campaign, part.even)
    (told,) = model.predict(values)
    offset = 1e-3 * max(float(np.abs(told).max()), 1e-300)
    own = {**sizes, **dict.fromkeys(offset_names(told.shape[1]), offset), PHASE: 1.0}
    return _RepeatRows(
        (replace(louder, sense_v=told), told),
        lambda at: model.predict(at)[0],
        lambda y: np.stack([y.real / sd_v, y.imag / sd_v], axis=2),
        lambda at, names: [one for (one,) in differences(model, at, names, own)],
    )


def _decay(part: EnvelopePart, k: int, scale: float, sizes: _Values, values: _Values) -> _RepeatRows:
    record, noise = part.records[k], part.row_noise[k]
    louder = replace(record, amplitude_v=scale * record.amplitude_v)
    # The sd of a phase and of a frequency is that of the amplitude, relative to it.
    phase, frequency = (None if sd is None else sd / scale for sd in (noise.phase_rad, noise.frequency_hz))
    clear = replace(noise, phase_rad=phase, frequency_hz=frequency)

    def model(own: EnvelopeRecord) -> EnvelopeModel:
        return replace(
            part.envelope,
            records=_with(part.records, k, own),
            noise=_with(part.row_noise, k, clear),
            fitted=_with(part.rows.fitted_rows, k, np.ones(own.time_s.size, dtype=np.bool_)),
            _states={},
        )

    told = model(louder).predict(values)[k]
    next_one = replace(
        louder,
        amplitude_v=told.amplitude_v,
        phase_rad=told.phase_rad,
        frequency_hz=None if record.frequency_hz is None else told.frequency_hz,
    )
    asked, senses = model(next_one), record.amplitude_v.shape[1]

    def shown(one: Predicted) -> FloatArray:
        columns = [one.amplitude_v / clear.amplitude_v]
        if one.phase_rad is not None and clear.phase_rad is not None:
            columns.append(np.where(np.isfinite(clear.phase_rad), one.phase_rad / clear.phase_rad, np.nan))
        if record.frequency_hz is not None and clear.frequency_hz is not None:
            # One frequency of all senses.
            score = np.where(np.isfinite(clear.frequency_hz), one.frequency_hz / clear.frequency_hz, np.nan)
            columns.append(np.where(np.arange(senses) == 0, score[:, None], np.nan))
        return np.stack(columns, axis=2)

    def slopes(at: _Values, names: Sequence[str]) -> list[Predicted]:
        def predict(point: _Values) -> tuple[FloatArray, ...]:
            one = asked.predict(point)[k]
            return (
                one.amplitude_v,
                np.zeros_like(one.amplitude_v) if one.phase_rad is None else one.phase_rad,
                one.frequency_hz,
            )

        zetas, found = damping_names(part.full), []
        for name in names:
            step = difference_step(zetas, name, at, sizes.get(name, 1.0))
            amplitude, phase, frequency = slope(predict, at, name, step, lower_bound(part.full, part.even, name))
            found.append(Predicted(amplitude, None if record.phase_rad is None else phase, frequency, frequency))
        return found

    return _RepeatRows((next_one, told), lambda at: asked.predict(at)[k], shown, slopes)


def _with(each: tuple[T, ...], k: int, one: T) -> tuple[T, ...]:
    """``each`` with ``one`` at place ``k``."""
    return (*each[:k], one, *each[k + 1 :])
