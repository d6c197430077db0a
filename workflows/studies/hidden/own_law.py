"""Truth of effects that the independent simulator does not state: their own law, through the forward model.

A campaign made this way tests the learning loop, not the law.  Units: volts, seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.effect import Context, Effect
from pipeline.device.model import Model
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Record

from .readout import PER_DRIVE
from .truth import OUTSIDE, STATED


def without_law(effects: Sequence[str]) -> tuple[str, ...]:
    """Those of the hidden ``effects`` that the independent simulator does not state.

    It states paths of single drives for linear devices only, beside no effect of another kind that acts on motion or drive.
    """
    plain = all(is_linear(name) for name in effects)
    known = STATED if plain else STATED - set(PER_DRIVE)
    return tuple(name for name in effects if name not in known and name not in OUTSIDE)


def is_linear(name: str) -> bool:
    """Whether a device with the stated effect ``name`` is linear and constant in time, so that its drives superpose."""
    if name not in STATED:
        return False
    return not set(Model().effect(name).stages) & {"drive", "force", "sense"}


def modelled_response(
    model: Model, effects: Sequence[str], values: Mapping[str, float], record: Record, instrument: Instrument
) -> FloatArray:
    """The noise-free record (N, 2) [V] of ``model`` with the ``effects`` at ``values``, converter stage included.

    Raises
    ------
    ConfigError : as in ``forward``.
    """
    # The records of a bench have a delay of their own, which is an effect, too.
    for name in {*effects, *(own.partition(".")[0] for own, value in values.items() if "." in own and value != 0.0)}:
        model = model.with_effect(name) if name in model.library else model
    known = {name: value for name, value in values.items() if name in model.by_name}
    return forward(model, known, record, instrument)


def own_disturbance(
    effect: Effect,
    values: Mapping[str, float],
    samples: int,
    instrument: Instrument,
    random: np.random.Generator,
) -> FloatArray:
    """(samples, 2) [V]: regressors of ``effect`` with random coefficients per channel, of rms "<effect>.a1"."""
    t = np.arange(samples) / instrument.sample_rate_hz
    p = np.array([values.get(effect.full_name(m), m.null) for m in effect.parameters])
    assert effect.disturbance is not None
    basis = effect.disturbance(t, p, Context(instrument.bias_v, instrument.bias_v, values))
    coefficients = random.standard_normal((basis.shape[1], 2)) / np.sqrt(max(basis.shape[1], 1))
    return np.asarray(values[f"{effect.name}.a1"] * basis @ coefficients)
