"""Amplitudes of a free decay beside a model, as numbers."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class DecayView:
    """The rows of one decay and what one model predicts for them.

    Parameters
    ----------
    record : name of the record.
    role : "fit" or "validate" (held out); "fit" where stretches of the record are held out.
    time_s : (N,) of each row [s], rising.
    measured_v, model_v : (N, S) peak amplitude of each sense [V].
    residual : (N, S) rms of (measured - model)/sd over what a row shows: amplitude, phase, frequency; 1 for noise alone.
    """

    record: str
    role: str
    time_s: FloatArray
    measured_v: FloatArray
    model_v: FloatArray
    residual: FloatArray
