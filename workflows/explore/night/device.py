"""One device of a run: its records as the screening saw them, its nightly model fitted again, and what is left.

A virtual device is simulated again from its seeds, which gives the same samples; a measured one is read from its campaign.

Shapes: F frequencies, T times, S senses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.errors import MeasurementError
from pipeline.inference.general.fit import fit_campaign
from reports.learning.record_view import RecordSpectra, RecordView, drive_band, spectra

from ...learning.views import record_views
from ...screening.lot.device import measurement_of, nightly_model
from .stored import NightData

#: Columns of the picture of a residual against time.
_COLUMNS = 300


@dataclass(frozen=True, eq=False)
class DeviceView:
    """Records of a device beside the fitted nightly model.

    Parameters
    ----------
    device_id, record : names.
    error : rms of the residual of the fit records [sigma], full band.
    spectra : amplitudes of measurement, model and residual in the band of the drive [V].
    time_s : (T,) middles of intervals [s].
    low, high : (T, S) smallest and largest residual of each interval [sigma].
    """

    device_id: str
    record: str
    error: float
    spectra: RecordSpectra
    time_s: FloatArray
    low: FloatArray
    high: FloatArray


@threadpool_limits.wrap(limits=1)
def device_view(night: NightData, number: int) -> DeviceView:
    """The records of device ``number``, simulated or read, and what the nightly model leaves, fitted from the stored estimates.

    Raises
    ------
    MeasurementError : it has no estimates to start from, its records cannot be read or have changed, or the fit fails.
    """
    start = [(name, float(night.value(name)[number])) for name in PHYSICAL]
    name = night.device_ids[number]
    if not all(np.isfinite(value) for _, value in start):
        raise MeasurementError(
            "the device has no estimates to start from",
            value=name,
            allowed="a device that was fitted",
            next_step="see its status",
        )
    campaign, noise, line = measurement_of(night.source, number)
    model, values = nightly_model(line, start)
    fit = fit_campaign(model, campaign, noise, values)
    views = [view for view in record_views(campaign, fit) if view.residual.shape[0] >= 64]
    if not views:
        raise MeasurementError("the device has no driven record", value=name, next_step="see its campaign")
    worst = max(views, key=lambda view: view.error)
    edges = np.linspace(0, worst.residual.shape[0], min(_COLUMNS, worst.residual.shape[0] // 8) + 1).astype(np.int64)
    return DeviceView(
        name,
        worst.name,
        _error(fit.error),
        spectra(worst, _band(worst)),
        np.asarray(0.5 * (edges[1:] + edges[:-1])) / worst.sample_rate_hz,
        np.minimum.reduceat(worst.residual, edges[:-1], axis=0),
        np.maximum.reduceat(worst.residual, edges[:-1], axis=0),
    )


def _error(errors: dict[str, float | None]) -> float:
    found = errors.get("fit")
    return float("nan") if found is None else found


def _band(view: RecordView) -> tuple[float, float]:
    """The band of the drive with a tenth of its width beyond each end [Hz]."""
    low, high = drive_band(view)
    room = 0.1 * (high - low)
    return max(low - room, 0.0), min(high + room, 0.5 * view.sample_rate_hz)
