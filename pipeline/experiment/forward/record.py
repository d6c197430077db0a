"""Forward model: the record that a model predicts from the drive samples, over the full band.

    v --drive--> u --mechanics, forces--> S --sense--> + feedthrough --read-out, delay--> ADC --> y

The linear response is exact at the sample times.  The response to force and sense effects is integrated on a finer grid
(``integrate``) and added.  Noise, offset and hum are not part of the prediction.

Shapes: N samples, D drives, S senses, n coordinates.  Units: volts.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ..instrument import Instrument
from ..record import Record
from .drive_groups import drive_group_of
from .response import converted, volts
from .sensitivity import channels_checked, jacobian
from .signatures import Signature, base_of, signatures
from .system import assemble

__all__ = ["Signature", "base_of", "forward", "jacobian", "signatures"]


def forward(
    model: Model,
    parameters: Mapping[str, float],
    record: Record,
    instrument: Instrument,
    *,
    angular_gain: float | None = None,
    start: FloatArray | None = None,
) -> FloatArray:
    """The record (N, S) [V] that ``model`` predicts at ``parameters``.

    Parameters
    ----------
    model : plant and effects.
    parameters : name -> value in the units of ``model.parameters()``; effects that are not named are at their null.
    record : its drive samples and declared conditions; its sense samples are not used.
    instrument : hold, bias, anti-alias filter.
    angular_gain : I_p / I_0p, needed for a declared rate other than zero.
    start : state (2n,) at the first sample: coordinates [V s], velocities [V]; ``None`` is rest.

    Raises
    ------
    ConfigError : a parameter is missing or impossible (negative stiffness or damping), or the motion diverges.
    MeasurementError : the record and the plant have different numbers of channels.
    """
    channels_checked(model, record)
    group = drive_group_of([record], instrument, angular_gain)
    system = assemble(model, model.complete(parameters), instrument, group.conditions)
    return np.asarray(converted(system, volts(system, group, [start])[0]))
