"""A sweep or a frequency response beside a model, as numbers."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class ToneView:
    """Rows of one record, level and direction, and what one model predicts for them.

    Parameters
    ----------
    record, label : name of the record; what the rows are ("up, level 1", or the drive of a response).
    role : "fit" or "validate" (held out).
    frequency_hz : (n,) in the order of measurement [Hz].
    level_v : (n,) level of the drive [V].
    measured_v, model_v : (n, S) complex amplitude of each sense [V].
    residual : (n, S) |measured - model| in units of the sd of X and of Y together, 1 for noise alone.
    """

    record: str
    label: str
    role: str
    frequency_hz: FloatArray
    level_v: FloatArray
    measured_v: ComplexArray
    model_v: ComplexArray
    residual: FloatArray
