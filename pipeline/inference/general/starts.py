"""Start values of a plant: modes from the spectra of the records, with transients, for any numbers of drives and senses.

In the driven band, with the frequency scaled to x in [-1, 1], every record obeys

    A(x) Y_a(x) = sum_d B_ad(x) U_d(x) + T_a(x),        A, B, T complex polynomials; A and B common to the records

The degree of A is the number of modes.  B and T are projected out, A is the smallest singular vector, and the rows are reweighted
by 1/|A| until the roots converge (Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56).  Residues follow from the
poles by linear least squares with exact transients.

Shapes: N samples, S senses, D drives, K modes.  Records in volts, poles in rad/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev
from scipy.fft import rfft

from ...arrays import ComplexArray, FloatArray
from ...axial import wrap
from ...device.gyro import M_D, PHYSICAL, to_physical
from ...device.model import Model
from ...device.plant import GyroPlant, ModalPlant
from ...errors import MeasurementError
from ...experiment.instrument import Instrument
from ...experiment.record import Record
from ..screening.compressed import BandData, nuisance_basis
from ..screening.fit import maximise, start_from_modes
from ..screening.inband import features, make_band
from .free_modes import free_poles

_ROUNDS = 20
#: Power of a line of a free decay over that of the strongest; a mode of a tenth of its amplitude counts.
_LINE = 1e-2
#: Degrees of B and T beyond that of A, for the tails of resonances outside the band.  Without it a fit of noise converges
#: (``test_a_record_of_noise_has_status_fit_failed_with_a_reason``).
_MORE = 1


def driven_band(records: Sequence[Record]) -> tuple[float, float]:
    """The band [low, high] Hz of the drives: all bins above 1 % of the strongest.

    Raises
    ------
    MeasurementError : no record is driven.
    """
    low, high = np.inf, 0.0
    for record in records:
        power = np.sum(np.abs(rfft(record.drive_v, axis=0)) ** 2, axis=1)
        power[0] = 0.0
        if power.max() > 0.0:
            hot = np.flatnonzero(power > 1e-2 * power.max())
            unit = record.sample_rate_hz / record.drive_v.shape[0]
            low, high = min(low, hot[0] * unit), max(high, hot[-1] * unit)
    if high <= low:
        raise MeasurementError("no record to fit is driven", next_step='give a driven record role = "fit"')
    return low, high


def excited_band(records: Sequence[Record]) -> tuple[float, float]:
    """The band [low, high] Hz in which records move: that of the drives, or around the lines of a free decay.

    Raises
    ------
    MeasurementError : nothing moves.
    """
    if any(np.any(record.drive_v) for record in records):
        return driven_band(records)
    lines = [free_lines(record) for record in records]
    low, high = min(line[0] for line in lines), max(line[1] for line in lines)
    if high <= low:
        raise MeasurementError("no record to fit moves", next_step="give a record with a drive or a free decay")
    return low, high


def free_lines(record: Record) -> tuple[float, float]:
    """From half of the lowest to one and a half times the highest line [Hz] of a record without a drive."""
    samples = record.sense_v.shape[0]
    taper = np.hanning(samples)[:, None]
    power = np.sum(np.abs(rfft((record.sense_v - record.sense_v.mean(axis=0)) * taper, axis=0)) ** 2, axis=1)
    power[:3] = 0.0
    hot = np.flatnonzero(power > _LINE * power.max())
    if not hot.size:
        return 0.0, 0.0
    unit = record.sample_rate_hz / samples
    return 0.5 * float(hot[0]) * unit, min(1.5 * float(hot[-1]) * unit, 0.49 * record.sample_rate_hz)


def modes_from_spectra(
    records: Sequence[Record], modes: int, low_hz: float, high_hz: float, sigma_v: FloatArray
) -> ComplexArray:
    """Poles (K,) [rad/s] of the modes in a band, sorted by frequency, all stable.

    Parameters
    ----------
    records : fit records.
    modes : their number K.
    low_hz, high_hz : the band.
    sigma_v : (S,) [V], weights of the senses.
    """
    centre, span = (low_hz + high_hz) / 2.0, (high_hz - low_hz) / 2.0
    blocks = []
    for record in records:
        samples = record.drive_v.shape[0]
        unit = record.sample_rate_hz / samples
        bins = np.arange(max(1, int(np.ceil(low_hz / unit))), int(np.floor(high_hz / unit)) + 1)
        y = rfft(record.sense_v / sigma_v, axis=0)[bins] / np.sqrt(samples)
        u = rfft(record.drive_v, axis=0)[bins] / np.sqrt(samples)
        blocks.append((chebyshev.chebvander((bins * unit - centre) / span, modes + _MORE), y, u))
    roots = np.zeros(modes, dtype=np.complex128)
    weight_roots: ComplexArray | None = None
    for _ in range(_ROUNDS):
        rows: list[ComplexArray] = []
        inputs: list[ComplexArray] = []
        for t, y, u in blocks:
            weight = np.ones(t.shape[0])
            if weight_roots is not None:
                distance = np.abs(t[:, 1][:, None] - weight_roots)
                weight = 1.0 / np.maximum(np.prod(distance, axis=1), 1e-12)
            transient, _ = np.linalg.qr(t * weight[:, None])
            a = np.concatenate([t[:, : modes + 1] * (y[:, s] * weight)[:, None] for s in range(y.shape[1])], axis=1)
            b = np.concatenate([t[:, :0], *(t * (u[:, d] * weight)[:, None] for d in range(u.shape[1]))], axis=1)
            rows.append(a - transient @ (transient.T @ a))
            inputs.append(b - transient @ (transient.T @ b))
        stacked, driven = np.concatenate(rows), np.concatenate(inputs)
        norms = np.linalg.norm(driven, axis=0)
        basis, size, _ = np.linalg.svd(driven / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
        basis = basis[:, size > 1e-10 * size[:1]]
        stacked = stacked - basis @ (basis.conj().T @ stacked)
        senses = stacked.shape[1] // (modes + 1)
        tall = np.concatenate([stacked[:, s * (modes + 1) : (s + 1) * (modes + 1)] for s in range(senses)])
        coefficients = np.linalg.svd(tall, full_matrices=False)[2][-1].conj()
        moved = chebyshev.chebroots(coefficients)
        if moved.size < modes:
            moved = np.concatenate([moved, np.full(modes - moved.size, 0.5j)])
        moved = moved[np.argsort(moved.real)]
        # Poles of a stable plant lie above the real x axis.
        weight_roots = moved.real + 1j * np.maximum(np.abs(moved.imag), 1e-9)
        if np.max(np.abs(moved - roots)) < 1e-9:
            break
        roots = moved
    x = np.asarray(weight_roots)
    p = 2j * np.pi * (centre + span * np.clip(x.real, -3.0, 3.0)) - 2.0 * np.pi * span * np.minimum(x.imag, 0.5)
    return np.asarray(p[np.argsort(p.imag)])


def residues_of(
    records: Sequence[Record], poles: ComplexArray, instrument: Instrument, low_hz: float, high_hz: float
) -> ComplexArray:
    """Residues (K, S, D) [1/s] of ``poles`` (K,) by least squares in the band [low, high] Hz, with exact transients."""
    rows, targets = [], []
    for record in records:
        band = make_band(record.drive_v, replace(instrument, sample_rate_hz=record.sample_rate_hz), low_hz, high_hz)
        plus = np.stack([features(band, complex(p)) for p in poles])
        minus = np.stack([features(band, complex(np.conj(p))) for p in poles])
        flat = (plus + minus).reshape(-1, band.bins.size), (1j * (plus - minus)).reshape(-1, band.bins.size)
        columns = np.concatenate(flat).T / np.sqrt(band.samples)
        rows.append(np.concatenate([columns.real, columns.imag]))
        y = band.transform(record.sense_v - record.sense_v.mean(axis=0)).T / np.sqrt(band.samples)
        targets.append(np.concatenate([y.real, y.imag]))
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    half = found.shape[0] // 2
    complex_found = found[:half] + 1j * found[half:]
    return np.asarray(np.moveaxis(complex_found.reshape(poles.size, -1, found.shape[1]), 2, 1))


def gyro_start(
    records: Sequence[Record], instrument: Instrument, sigma_v: FloatArray, low_hz: float, high_hz: float
) -> FloatArray:
    """Cartesian parameters (12,) [units of ``device.gyro``] from spectra in the band [Hz]; needs hold "zoh" or "foh"."""
    poles = modes_from_spectra(records, 3, low_hz, high_hz, sigma_v)
    residues = residues_of(records, poles, instrument, low_hz, high_hz)
    # The residues of up-down motion have equal signs; those of rocking motion cancel in the sum.
    alike = residues.real.sum(axis=(1, 2)) / np.linalg.norm(residues.real, axis=(1, 2))
    third = int(np.argmax(alike))
    order = [k for k in range(3) if k != third] + [third]
    return start_from_modes(poles[order], residues[order])


def find_start(
    model: Model, records: Sequence[Record], instrument: Instrument, sigma_v: FloatArray
) -> dict[str, float]:
    """Start values of the plant's parameters by name, and of c12_per_s if the model has it.

    Parameters
    ----------
    model : its plant determines the number of modes.
    records : fit records.
    instrument : hold and filter; hold "bandlimited" is approximated by "foh".
    sigma_v : (S,) [V].

    Raises
    ------
    MeasurementError : no record is driven or in motion, or a gyro is not driven.
    """
    if not any(np.any(r.drive_v) for r in records):
        return _free_values(model, records, sigma_v)
    records = [r for r in records if np.any(r.drive_v)]
    low, high = driven_band(records)
    held = instrument if instrument.hold != "bandlimited" else replace(instrument, hold="foh")
    plant = model.built
    if isinstance(plant, ModalPlant):
        poles = modes_from_spectra(records, plant.modes, low, high, sigma_v)
        return _modal_values(plant, poles, residues_of(records, poles, held, low, high))
    assert isinstance(plant, GyroPlant)
    if not plant.updown:
        return _rocking_values(model, plant, start_of_rocking(plant, records, held, sigma_v, low, high))
    x = gyro_start(records, held, sigma_v, low, high)
    data = []
    for record in records:
        band = make_band(record.drive_v, replace(held, sample_rate_hz=record.sample_rate_hz), low, high)
        data.append(BandData(band, band.transform(record.sense_v), nuisance_basis(band, None)))
    fitted = maximise(data, sigma_v, x)
    return _rocking_values(model, plant, fitted.x if np.all(np.isfinite(fitted.x)) else x)


def _rocking_values(model: Model, plant: GyroPlant, x: FloatArray) -> dict[str, float]:
    """Values by name from cartesian parameters (12,) in the frame of the electrodes."""
    values = dict(zip(PHYSICAL, to_physical(x[None])[0].tolist()))
    if plant.frame_deg[0] != 0.0:
        values["theta_deg"] = float(wrap(values["theta_deg"] + plant.frame_deg[0]))
    return {name: values[name] for name in PHYSICAL if name in model.by_name}


def start_of_rocking(
    plant: GyroPlant,
    records: Sequence[Record],
    instrument: Instrument,
    sigma_v: FloatArray,
    low_hz: float,
    high_hz: float,
) -> FloatArray:
    """Cartesian parameters (12,) of a ``plant`` without up-down mode; its imbalances start at zero.  As :func:`gyro_start`."""
    poles = modes_from_spectra(records, 2, low_hz, high_hz, sigma_v)
    residues = residues_of(records, poles, instrument, low_hz, high_hz)
    # As if the drives had the frame of the senses.
    senses_deg, drives_deg = np.deg2rad(plant.frame_deg)
    c, s = np.cos(drives_deg - senses_deg), np.sin(drives_deg - senses_deg)
    residues = residues @ np.linalg.solve(np.array([[c, -s], [s, c]]) @ M_D, M_D)
    # Any third mode with equal gains.
    return start_from_modes(np.concatenate([poles, 1.5 * poles[:1]]), np.concatenate([residues, np.ones((1, 2, 2))]))


def _free_values(model: Model, records: Sequence[Record], sigma_v: FloatArray) -> dict[str, float]:
    """Frequencies and damping ratios of a modal plant from records that are not driven: without a drive there are no gains."""
    plant = model.built
    if not isinstance(plant, ModalPlant):
        raise MeasurementError("no record to fit is driven", next_step='give a driven record role = "fit"')
    poles = modes_from_spectra(records, plant.modes, *excited_band(records), sigma_v)
    poles = free_poles(records, plant.modes, sigma_v, poles)
    none = np.zeros((plant.modes, plant.senses, plant.drives), dtype=np.complex128)
    return _modal_values(plant, poles, none)


def _modal_values(plant: ModalPlant, poles: ComplexArray, residues: ComplexArray) -> dict[str, float]:
    """Frequency [Hz], damping ratio and real gains of each mode, from poles (K,) [rad/s] and residues (K, S, D) [1/s]."""
    values: dict[str, float] = {}
    for k, p in enumerate(poles):
        values[f"f{k + 1}_hz"] = abs(p) / (2.0 * np.pi)
        values[f"zeta{k + 1}"] = float(np.clip(-p.real / abs(p), 1e-6, 0.9))
        gain = (residues[k] * 2j * p.imag / p**plant.derivative).real
        for a in range(plant.senses):
            for b in range(plant.drives):
                values[f"gain{k + 1}_s{a + 1}d{b + 1}"] = float(gain[a, b])
    return values
