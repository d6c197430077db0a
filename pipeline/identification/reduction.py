"""Reduction of a high-order ARX model to three modes in two ways, and the model order and record length that it needs.

balanced   six states of the balanced realisation, as the paper does it; moves theta by some 0.02 to 0.04 deg, since the
           truncated states are not orthogonal to the three modes
modal      the three dominant terms of the partial fractions; no bias of this kind

Units: hertz, degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..experiment.instrument import Instrument
from ..experiment.record import Record
from .arx import ArxModel, fit_arx
from .bandpass import bandpass, window_slice
from .failure import IdentificationError
from .hankel import balance, frequency_response, modes_of_states, state_space_of, truncate
from .modes import modes_of, to_continuous
from .route import RouteResult, route_from_modes

_STATES = 6
_BAND_HZ = (400.0, 700.0)


@dataclass(frozen=True, eq=False)
class Reduction:
    """Three modes by balanced and by modal truncation.

    hankel : (K,) Hankel singular values of the ARX model [1].
    error_bound : 2 sum of the values truncated, an upper bound of |H - H_6|_inf.
    """

    hankel: FloatArray
    error_bound: float
    balanced: RouteResult
    modal: RouteResult

    @property
    def theta_shift_deg(self) -> float:
        """Axial mean of theta, balanced less modal [deg]."""
        return (self.balanced.axes.mean_deg - self.modal.axes.mean_deg + 90.0) % 180.0 - 90.0


def reduce_model(model: ArxModel, instrument: Instrument, band_hz: tuple[float, float] = _BAND_HZ) -> Reduction:
    """Truncate to six states both ways, invert the hold, correct the phase, find the axes.

    Parameters
    ----------
    model : ARX model of band-passed data, with the ridge of ``fit_arx``: the minimum-norm or nearly unpenalised model
        has strong modes outside the driven band, which displace the up-down mode from the first six states.
    instrument : its sample rate, hold and filter.
    band_hz : where modal truncation looks for modes [Hz].

    Raises
    ------
    IdentificationError : the model is unstable, or six states are not three modes of a gyro.
    """
    rate, hold = instrument.sample_rate_hz, instrument.hold
    balanced = balance(state_space_of(model))
    reduced = modes_of_states(truncate(balanced, _STATES))
    if reduced.poles.size != _STATES // 2:
        raise IdentificationError(
            "six balanced states are not three oscillating modes",
            value=int(reduced.poles.size),
            allowed="3",
            next_step="use a larger ridge or a lower order",
        )
    return Reduction(
        balanced.hankel,
        float(2.0 * balanced.hankel[_STATES:].sum()),
        route_from_modes(to_continuous(reduced, rate, hold), instrument.antialias),
        route_from_modes(to_continuous(modes_of(model, rate, band_hz), rate, hold), instrument.antialias),
    )


@dataclass(frozen=True, eq=False)
class OrderStep:
    """The route at one order and window.

    phase_change_deg : (S, D) rms over 450 to 650 Hz, weighted with |H|^2, of the phase of this model against that of
        the highest order and same window [deg].
    """

    order: int
    window_s: float
    result: RouteResult
    phase_change_deg: FloatArray


def order_study(
    record: Record, instrument: Instrument, orders: Sequence[int], windows_s: Sequence[float] = (2.0, 3.0)
) -> tuple[OrderStep, ...]:
    """Theta, split and in-band phase against the order of the ARX model and the length of the data (Section 4.1).

    Parameters
    ----------
    record, instrument : as for ``identify_record``.
    orders : ARX orders; the paper uses 10 to 80.
    windows_s : lengths of the window around the largest signal [s].

    Raises
    ------
    IdentificationError : the route fails for one of these settings.
    """
    rate, senses = record.sample_rate_hz, record.sense_v.shape[1]
    both = bandpass(np.concatenate([record.sense_v, record.drive_v], axis=1), rate, *_BAND_HZ)
    grid = np.linspace(450.0, 650.0, 401)
    steps = []
    for window_s in windows_s:
        window = both[window_slice(both[:, :senses], rate, window_s)]
        models = {
            n: fit_arx(window[:, :senses], window[:, senses:], n, direct=instrument.hold != "zoh")
            for n in sorted(set(orders))
        }
        reference = frequency_response(models[max(models)], grid, rate)
        weight = np.abs(reference) ** 2
        for n, model in models.items():
            turned = np.angle(frequency_response(model, grid, rate) / reference, deg=True)
            change = np.sqrt(np.sum(weight * turned**2, axis=0) / weight.sum(axis=0))
            modes = to_continuous(modes_of(model, rate, _BAND_HZ), rate, instrument.hold)
            steps.append(OrderStep(n, window_s, route_from_modes(modes, instrument.antialias), change))
    return tuple(steps)
