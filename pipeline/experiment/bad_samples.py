"""Bad samples of a record: spikes, stuck samples, dropouts and samples at the full scale of the ADC.

Each sense channel is predicted from its own past and the drives (ARX model, fitted to the record by least squares):

    e[n] = sum_k A_k y[n-k] - sum_d sum_k B_dk u_d[n-k] - c,        A_0 = 1
    size of a spike at n:   s[n] = sum_k A_k e[n+k] / |A|^2          (matched filter; its sd is that of e over |A|)

so a spike is found against noise of any colour and under any smooth motion; ``outliers`` seeks spikes and stuck samples, and bad
samples are interpolated so that sum e^2 is least.  Clipping below full scale is an effect, adc_saturation, and
is never marked.

Shapes: N samples, S senses, D drives, K bad samples of a channel.  Volts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..errors import MeasurementError
from ..threads import mapped
from .arx import Arx
from .instrument import Adc
from .outliers import MOST_BAD as MOST_BAD
from .outliers import outliers, parts, stretches
from .record import BadReason, BadStretch, Campaign, Record


def bad_stretches(record: Record, adc: Adc | None) -> tuple[BadStretch, ...]:
    """The bad samples of ``record``, in the order of channels and time; ``adc`` is the declared converter, if any."""
    out: list[BadStretch] = []
    drive_v = record.drive_v[:, np.any(record.drive_v != 0.0, axis=0)]
    for channel, y in enumerate(record.sense_v.T):
        full = np.zeros(y.size, dtype=bool)
        if adc is not None:
            full = (y >= adc.full_scale_v - 1.5 * adc.lsb_v) | (y <= -adc.full_scale_v + 0.5 * adc.lsb_v)
        found, stuck = outliers(np.ascontiguousarray(y), drive_v, full)
        masks: dict[BadReason, BoolArray] = {
            "full_scale": full,
            "dropout": stuck & (y == 0.0) & ~full,
            "stuck": stuck & (y != 0.0) & ~full,
            "spike": found & ~stuck & ~full,
        }
        for reason, mask in masks.items():
            out += [BadStretch(channel, first, stop, reason) for first, stop in stretches(mask)]
    return tuple(sorted(out, key=lambda one: (one.channel, one.first)))


def without_bad_samples(campaign: Campaign, threads: int = 1) -> Campaign:
    """The campaign with its bad samples marked (``Record.bad``) and interpolated; records already marked stay as they are.

    ``threads`` records are examined at the same time.

    Raises
    ------
    MeasurementError : a channel of a record has more than ``MOST_BAD`` bad samples.
    """

    def examined(record: Record) -> Record:
        return _accepted(record if record.bad is not None else marked(record, campaign.instrument.adc))

    return replace(campaign, records=tuple(mapped(examined, campaign.records, threads)))


def refilled(record: Record, predicted_v: FloatArray) -> Record:
    """A marked record whose bad samples are the prediction (N, S) [V] plus the interpolated residual."""
    good = record.good
    if good is None:
        return record
    rest = record.sense_v - predicted_v
    return replace(record, sense_v=predicted_v + _interpolated(rest, np.zeros((rest.shape[0], 0)), good))


def share_of_bad(record: Record) -> float:
    """Share of bad samples in the worst channel of a marked record [1]."""
    counts = np.zeros(record.sense_v.shape[1])
    for one in record.bad or ():
        counts[one.channel] += one.stop - one.first
    return float(counts.max(initial=0.0)) / record.sense_v.shape[0]


def marked(record: Record, adc: Adc | None) -> Record:
    """``record`` with its bad samples marked and, up to ``MOST_BAD``, interpolated."""
    found = replace(record, bad=bad_stretches(record, adc))
    if found.good is None or share_of_bad(found) > MOST_BAD:
        return found
    return replace(found, sense_v=_interpolated(record.sense_v, record.drive_v, found.good))


def _accepted(record: Record) -> Record:
    share = share_of_bad(record)
    if share > MOST_BAD:
        reasons = ", ".join(sorted({one.reason for one in record.bad or ()}))
        raise MeasurementError(
            f"{record.name}: too many bad samples ({reasons})",
            value=f"{100.0 * share:.2g} % of the samples of one channel",
            allowed=f"at most {100.0 * MOST_BAD:g} %",
            next_step="run gyroscreen check for the list, then measure again or cut the record with start and stop",
        )
    return record


def _interpolated(sense_v: FloatArray, drive_v: FloatArray, good: BoolArray) -> FloatArray:
    """sense (N, S) [V] with the samples that are not ``good`` (N, S) interpolated; drive (N, D) [V]."""
    out, drive_v = sense_v.copy(), drive_v[:, np.any(drive_v != 0.0, axis=0)]
    for own, wide in parts(sense_v.shape[0]):
        inside = slice(own.start - wide.start, own.stop - wide.start)
        for channel in np.flatnonzero(~good[own].all(axis=0)).tolist():
            bad, y = ~good[wide, channel], sense_v[wide, channel]
            found = Arx.fitted(y, drive_v[wide], bad).interpolated(y, np.flatnonzero(bad))
            out[own, channel] = found[inside]
    return out
