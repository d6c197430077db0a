"""Forward model: the record that a model at given parameters would give, full band, from the drive samples.

    v --drive--> u --mechanics, forces--> S --sense--> + feedthrough --read-out, delay--> converter --> y

Linear parts are exact at the sample times.  Where a force or a pick-off law acts, its remainder on top of the linear
part is integrated on a finer grid (``integrate``) and added.  Noise, offset and hum are not part of it.

Shapes: N samples, D drives, S senses.  Units: volts.
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
    """The record (N, S) [V] that ``model`` gives at ``parameters``.

    Parameters
    ----------
    model : plant and effects.
    parameters : name -> value in the units of ``model.parameters()``; effects that are not named are at their null.
    record : its drive samples and declared conditions; its sense samples are not used.
    instrument : hold, bias, filter.
    angular_gain : I_p / I_0p, needed for a declared rate other than zero.
    start : state (2n,) at the first sample: coordinates [V s], velocities [V]; ``None`` is rest.

    Raises
    ------
    ConfigError : parameters that no device can have, or a motion that diverges.
    MeasurementError : a record whose numbers of channels are not the plant's.
    """
    channels_checked(model, record)
    group = drive_group_of([record], instrument, angular_gain)
    system = assemble(model, model.complete(parameters), instrument, group.conditions)
    return np.asarray(converted(system, volts(system, group, [start])[0]))
