"""Virtual devices for the page of the paper: records, models of high order, convergence, one step against two, biases.

The virtual device has the frequencies and dampings of eq. (15), the gains of M3 and the mean of the four printed thetas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.device.gyro import PHYSICAL, gyro_modes, to_cartesian, to_physical
from pipeline.device.model import Model
from pipeline.device.operation.bias import rate_biases_dps
from pipeline.device.operation.rebalance import operate, self_oscillation_hz, settled
from pipeline.experiment.antialias import Bank, behind_filter
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.modal_bank import respond
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.noise.measure import Hum, measured
from pipeline.experiment.record import Record
from pipeline.identification.arx import ArxModel
from pipeline.identification.axes import axes, gains_from_updown
from pipeline.identification.bandpass import bandpass, window_slice
from pipeline.identification.failure import IdentificationError
from pipeline.identification.hankel import balance, frequency_response, state_space_of, truncate
from pipeline.identification.lattice import fit_arx_lattice
from pipeline.identification.modes import ContinuousModes, hold_gain
from pipeline.identification.reduction import order_study
from pipeline.identification.route import identify_record
from pipeline.inference.estimate import intervals
from pipeline.inference.screening.compressed import BandData, nuisance_basis
from pipeline.inference.screening.fit import Fit, maximise, start_from_modes
from pipeline.inference.screening.inband import Band, make_band
from reports.paper.content import BiasRow, OrderView, PaperRecord, ResponseView, StepsView

from .numbers import Eq14

INSTRUMENT = Instrument(antialias=AntiAlias(), adc=Adc())
ORDER = 40
_HUM = Hum(60.0, (0.02, 0.004, 0.01, 0.002, 0.006, 0.001, 0.001, 0.0005, 0.0005))
#: Inverse gap of the sense electrodes [1/(V s)]: a second harmonic some 30 dB below the motion, as in figure 4.
_INVERSE_GAP = 10.0
_LATTICE_RIDGE = 1e-12
_STREAM = 108
#: Assumed angular gain and off-diagonal damping of the bias table: the paper states neither.
KAPPA = 0.7
BIAS_C12 = 0.5
TAU = 2.0 * np.pi
#: Frequencies of figure 6 [Hz].
ROCKING_HZ: FloatArray = np.linspace(531.0, 540.0, 361)
UPDOWN_HZ: FloatArray = np.linspace(575.0, 606.0, 249)


def paper_physical(eq14: Eq14) -> FloatArray:
    """Physical parameters (12,) of the virtual device: the axial mean of the four thetas, c12 = 0."""
    route, f, zeta = eq14.route, eq14.record.frequency_hz, eq14.record.zeta
    rocking = float(np.mean([size[0] for size in route.axes.singular_values]))
    gains = route.gains
    named = {f"f{k + 1}_hz": float(f[k]) for k in range(3)} | {f"zeta{k + 1}": float(zeta[k]) for k in range(3)}
    named |= {"theta_deg": route.axes.mean_deg, "c12_per_s": 0.0, "rocking_gain": rocking}
    named |= {"updown_gain": gains.updown_gain}
    named |= {"sense_imbalance": gains.sense_imbalance, "drive_imbalance": gains.drive_imbalance}
    return np.array([named[name] for name in PHYSICAL])


def _noisy(volts: FloatArray, seed: int, snr_db: float = 60.0) -> tuple[FloatArray, float]:
    window = window_slice(volts, INSTRUMENT.sample_rate_hz)
    sigma = float(np.sqrt(np.mean(volts[window] ** 2)) * 10.0 ** (-snr_db / 20.0))
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
    return measured(volts, INSTRUMENT.sample_rate_hz, sigma, _HUM, INSTRUMENT.adc, random), sigma


def eq14_record(eq14: Eq14, seed: int) -> Record:
    """A record (N, 2) [V] of the paper's experiment, simulated from eq. (14); ``seed`` is that of the noise.

    The poles and residues of eq. (14) contain the anti-alias filter, so none is applied.
    """
    rate = INSTRUMENT.sample_rate_hz
    drive = drive_samples(Chirp(), rate)
    volts = respond(Bank(eq14.modes.poles[None], eq14.modes.residues[None]), drive, rate, "zoh")[0]
    return Record("eq. (14)", rate, drive, _noisy(volts, 100_000 + seed)[0])


def paper_record(physical: FloatArray) -> tuple[Record, float]:
    """A record (N, 2) [V] of the paper's experiment on the virtual device ``physical`` (12,), and sigma [V].

    Its sense electrodes are nonlinear, which gives the second harmonic of figure 4.
    """
    rate = INSTRUMENT.sample_rate_hz
    drive = drive_samples(Chirp(), rate)
    model = Model(effects=("sense_nonlinearity",))
    inverse_gap = model.effect("sense_nonlinearity").full_name(model.effect("sense_nonlinearity").parameters[0])
    values = {name: float(v) for name, v in zip(PHYSICAL, physical) if name in model.by_name}
    empty = Record("figure 4", rate, drive, np.zeros_like(drive))
    volts = forward(model, {**values, inverse_gap: _INVERSE_GAP}, empty, INSTRUMENT)
    sense, sigma = _noisy(volts, 4)
    return Record("figure 4", rate, drive, sense), sigma


def record_view(record: Record, physical: FloatArray) -> PaperRecord:
    """Figure 4: the record (N, 2) [V] and its power spectral density (F, 2) [V^2/Hz] (Welch); ``physical`` (12,)."""
    rate, count = record.sample_rate_hz, record.sense_v.shape[0]
    frequency, psd = welch(record.sense_v, rate, nperseg=8192, axis=0)
    return PaperRecord(
        np.arange(count) / rate, record.sense_v, frequency, np.asarray(psd), _HUM.frequency_hz,
        (float(physical[0]), float(physical[2])),
    )  # fmt: skip


def lattice_model(record: Record, order: int = ORDER, window_s: float = 2.0) -> ArxModel:
    """The paper's ARX model: bandpass, the window [s] around the largest signal, lattice filter."""
    both = bandpass(np.concatenate([record.sense_v, record.drive_v], axis=1), record.sample_rate_hz)
    window = both[window_slice(both[:, :2], record.sample_rate_hz, window_s)]
    return fit_arx_lattice(window[:, :2], window[:, 2:], order, _LATTICE_RIDGE)


def _of_modes(modes: ContinuousModes, frequency_hz: FloatArray) -> ComplexArray:
    """Response (F, 2, 2) of continuous modes behind the zero-order hold, at the samples."""
    rate = INSTRUMENT.sample_rate_hz
    z = np.exp(2j * np.pi * frequency_hz / rate)[:, None, None, None]
    pole = np.exp(modes.poles / rate)[:, None, None]
    residues = modes.residues * hold_gain(modes.poles, rate, "zoh")[:, None, None]
    return np.asarray(np.sum(residues / (z - pole) + np.conj(residues) / (z - np.conj(pole)), axis=1))


def response_view(model: ArxModel, modal: ContinuousModes, eq14: Eq14) -> ResponseView:
    """Figures 5 and 6: responses (F, 2, 2) of the ARX model, its six states by two truncations, and eq. (14)."""
    rate = INSTRUMENT.sample_rate_hz
    wide, narrow = np.geomspace(100.0, 5000.0, 900), np.concatenate([ROCKING_HZ, UPDOWN_HZ])
    six = truncate(balance(state_space_of(model)), 6)
    return ResponseView(
        wide,
        frequency_response(model, wide, rate),
        narrow,
        {
            f"ARX order {ORDER}": frequency_response(model, narrow, rate),
            "six states, balanced": frequency_response(six, narrow, rate),
            "three modes": _of_modes(modal, narrow),
            "eq. (14), printed": _of_modes(eq14.modes, narrow),
        },
    )


def order_view(record: Record, physical: FloatArray, orders: tuple[int, ...]) -> OrderView:
    """Estimates against the ARX order, from windows of 2 s and 3 s; truth from ``physical`` (12,)."""
    windows = (2.0, 3.0)
    steps = order_study(record, INSTRUMENT, orders, windows)
    by_window = [[step for step in steps if step.window_s == w] for w in windows]
    return OrderView(
        np.array(sorted(orders), dtype=np.float64),
        windows,
        tuple(np.array([s.result.axes.theta_deg for s in some]) for some in by_window),
        tuple(np.array([s.result.arx_split_hz for s in some]) for some in by_window),
        tuple(np.array([float(np.max(s.phase_change_deg)) for s in some]) for some in by_window),
        float(physical[6]),
        float(physical[1] - physical[0]),
    )


def _band(record: Record) -> tuple[Band, FloatArray]:
    band = make_band(record.drive_v, INSTRUMENT, 400.0, 700.0)
    return band, nuisance_basis(band, _HUM.frequency_hz)


def one_step(record: Record, sigma_v: float, shared: tuple[Band, FloatArray], start: FloatArray) -> Fit:
    """Maximum-likelihood fit of the physical model from ``start`` (12,); ``shared`` is the band and nuisance basis."""
    band, nuisance = shared
    adc = INSTRUMENT.adc
    total = np.hypot(sigma_v, adc.lsb_v / np.sqrt(12.0) if adc else 0.0)
    data = BandData(band, band.transform(record.sense_v), nuisance)
    return maximise([data], np.full(2, total), start)


def fit_summary(fit: Fit, seed: int = 1) -> dict[str, float]:
    """Estimates, sd and intervals of the physical parameters from 4000 draws of N(x, covariance) at the maximum."""
    scale = np.sqrt(np.diag(fit.covariance))
    factor = np.linalg.cholesky(fit.covariance / np.outer(scale, scale)) * scale[:, None]
    draws = fit.x + np.random.default_rng(seed).standard_normal((4000, fit.x.size)) @ factor.T
    physical = to_physical(draws)
    return intervals(dict(zip(PHYSICAL, physical.T)) | {"split_hz": physical[:, 1] - physical[:, 0]})


def fit_record(record: Record, sigma_v: float) -> dict[str, float]:
    """Summary of the one-step fit of a record with noise ``sigma_v`` [V], started from the two-step route."""
    route = identify_record(record, INSTRUMENT, ORDER)
    return fit_summary(one_step(record, sigma_v, _band(record), start_from_modes(route.poles, route.residues)))


def _axis_difference(angle_deg: float) -> float:
    """|angle| [deg] between two axes, in [0, 90], from the difference of their angles."""
    return abs((angle_deg + 90.0) % 180.0 - 90.0)


def steps_view(physical: FloatArray, splits: FloatArray, shares: FloatArray) -> StepsView:
    """Errors of theta [deg] of the two-step route and of the one-step fit, on one record at 60 dB for each pair.

    ``splits`` (n,) [Hz]; ``shares`` (m,) are c12 / sqrt(c11 c22).
    """
    shape = (shares.size, splits.size)
    route_deg, limit_deg, fit_deg, sd_deg = (np.full(shape, np.nan) for _ in range(4))
    shared: tuple[Band, FloatArray] | None = None
    drive = drive_samples(Chirp(), INSTRUMENT.sample_rate_hz)
    for i, share in enumerate(shares):
        for j, split in enumerate(splits):
            device = physical.copy()
            device[1] = device[0] + split
            device[7] = share * 2.0 * TAU * np.sqrt(device[3] * device[4] * device[0] * device[1])
            theta = float(device[6])
            modes = gyro_modes(device[None])
            exact = 2.0 * modes.residues[0].real
            limit_deg[i, j] = _axis_difference(axes(exact[0], exact[1], gains_from_updown(exact[2])).mean_deg - theta)
            bank = behind_filter(modes, INSTRUMENT.antialias)
            volts = respond(bank, drive, INSTRUMENT.sample_rate_hz, INSTRUMENT.hold)[0]
            sense, sigma = _noisy(volts, 1000 * i + j)
            record = Record("virtual", INSTRUMENT.sample_rate_hz, drive, sense)
            shared = shared or _band(record)
            start = to_cartesian(device[None])[0]
            try:
                route = identify_record(record, INSTRUMENT, ORDER)
                route_deg[i, j] = _axis_difference(route.axes.mean_deg - theta)
                start = start_from_modes(route.poles, route.residues)
            except IdentificationError:
                # The ARX model has one pole for both modes, so the route fails, and the fit starts near the truth.
                start[:6] += 0.05
            fit = one_step(record, sigma, shared, start)
            if fit.converged:
                found = fit_summary(fit)
                fit_deg[i, j], sd_deg[i, j] = _axis_difference(found["theta_deg"] - theta), found["theta_deg_sd"]
    return StepsView(splits, shares, route_deg, limit_deg, fit_deg, sd_deg)


def bias_rows(physical: FloatArray) -> tuple[BiasRow, ...]:
    """Eq. (3) to (6): as printed, as corrected, and measured on the simulated loops of figure 3; ``physical`` (12,)."""
    device = physical.copy()
    device[7] = BIAS_C12
    rate_dps, phase = 10.0, 1.0
    at_rest = settled(operate(device[None], KAPPA))
    turning = settled(operate(device[None], KAPPA, rate_dps))
    f1, f2, _, zeta1, zeta2, _, theta, c12 = device[:8]
    w1, w2, double = TAU * f1, TAU * f2, np.deg2rad(2.0 * theta)
    c11, c22 = 2.0 * zeta1 * w1, 2.0 * zeta2 * w2
    single = double / 2.0
    w0 = TAU * float(self_oscillation_hz(device[None])[0])
    c_yy = c11 * np.sin(single) ** 2 + c22 * np.cos(single) ** 2 + c12 * np.sin(double)
    quadrature = -0.5 * (w1**2 - w2**2) * np.sin(double) / w0
    delta = 0.5 * (c11 - c22) * np.sin(double)
    inphase = delta + c12 * np.cos(double)
    slope = float((turning.inphase_per_s[0] - at_rest.inphase_per_s[0]) / np.deg2rad(rate_dps))
    biases = rate_biases_dps(device[None], KAPPA, phase, "f1")
    unprinted = delta + 0.5 * c12 * np.cos(double)
    loops_bias = -np.rad2deg(at_rest.inphase_per_s[0] + at_rest.quadrature_per_s[0] * np.tan(np.deg2rad(phase)))
    printed_bias = -np.rad2deg(unprinted - 0.5 * (w1**2 - w2**2) / w0 * np.sin(double) * np.tan(np.deg2rad(phase)))
    return (
        BiasRow("(3)", "damping of ψ_y", "1/s", c_yy, c_yy, float(at_rest.damping_per_s[0]), ""),
        BiasRow("(3)", "free frequency of ψ_y", "Hz", w0 / TAU, w0 / TAU, float(at_rest.frequency_hz[0]), ""),
        BiasRow("(4), (5)", "quadrature torque / ψ_y′", "1/s", quadrature, quadrature,
                float(at_rest.quadrature_per_s[0]), "sin ω₀t lags ψ_y′ = A cos ω₀t by 90°, hence the sign"),
        BiasRow("(4), (5)", "in-phase torque / ψ_y′ at rest", "1/s", unprinted, inphase,
                float(at_rest.inphase_per_s[0]), "printed: ½ c12 cos 2θ; eq. (2) gives c12 cos 2θ"),
        BiasRow("(4)", "in-phase torque / (ψ_y′ Ω)", "1", -2.0 * KAPPA, -2.0 * KAPPA, slope, "eq. (4) is right"),
        BiasRow("(5)", "in-phase torque / (ψ_y′ Ω)", "1", -KAPPA, -2.0 * KAPPA, slope,
                "the factor 2 before (I_p/I_0p) Ω is missing in the print"),
        BiasRow("(6)", "rate bias at φ_E = 1°", "deg/s", float(printed_bias / (2.0 * KAPPA)),
                float(biases["rate_bias_dps"][0]), float(loops_bias / (2.0 * KAPPA)),
                "printed with ½ c12 (A/2 or A²/2 is only a scale); the formula takes ω₀ = ω₁, the loops run between ω₁ and ω₂"),
    )  # fmt: skip


@dataclass(frozen=True)
class StudySizes:
    """How much the page computes.

    orders : of the convergence study.
    splits_hz, shares : splits and shares of the greatest c12, of one step against two.
    noises : records of eq. (14) with different noise.
    """

    orders: tuple[int, ...] = (10, 15, 20, 25, 30, 40, 50, 60, 70, 80)
    splits_hz: tuple[float, ...] = tuple(float(x) for x in np.geomspace(0.05, 4.0, 14).round(4))
    shares: tuple[float, ...] = (0.0, 0.1, 0.5)
    noises: int = 9
