"""Effects that a device may have without being noticed: signatures without simulation, scores, bounds of the bias."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from plants import PAPER_LIKE
from scipy.stats import kstest

from pipeline.device.gyro import PHYSICAL, to_cartesian
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record
from pipeline.inference.gate import Gate, GoodnessOfFit, Undetected, status_of
from pipeline.inference.screening.compressed import BandData, compress
from pipeline.inference.screening.fit import Fit, modes_at
from pipeline.inference.screening.inband import make_band
from pipeline.inference.screening.mismatch import BROAD, NIGHTLY_MODEL
from pipeline.inference.screening.undetected.bounds import (
    Candidates,
    EffectEvidence,
    Projection,
    judged,
    summary,
)
from pipeline.inference.screening.undetected.clipping import adc_sizes, drive_sizes, loud_samples
from pipeline.inference.screening.undetected.library import probes_of, scored_effects
from pipeline.inference.screening.undetected.linear import linear_devices
from pipeline.inference.screening.undetected.linear_stages import moved_mechanics
from pipeline.inference.screening.undetected.parity import kind_of
from pipeline.inference.screening.undetected.signatures import along_motions, band_motion, signatures
from pipeline.inference.screening.undetected.slopes import feature_slopes

RATE = 10_000.0
INSTRUMENT = Instrument(antialias=AntiAlias())
DRIVE = drive_samples(Chirp(), RATE)
MISMATCH = {"electrode_mismatch.m_D": 3e-3, "electrode_mismatch.m_S": -2e-3}


@pytest.fixture(scope="module")
def device():
    """The paper's device with c12 and mismatches: parameters by name, its transform without effects, its signatures by effect."""
    values = {**PAPER_LIKE, "c12_per_s": 0.3, **MISMATCH}
    model = replace(NIGHTLY_MODEL, prior={})
    record = Record("chirp", RATE, DRIVE, np.zeros_like(DRIVE), role="fit")
    y = forward(model, values, record, INSTRUMENT)
    x = np.concatenate([to_cartesian(np.array([[values[name] for name in PHYSICAL]]))[0], list(MISMATCH.values())])
    band = make_band(DRIVE, INSTRUMENT, 400.0, 700.0)
    data = BandData(band, band.transform(y), np.zeros((2 * band.bins.size, 0)))
    likelihood = compress([data], np.full(2, 1e-3), modes_at(x)[0], BROAD)
    fit = Fit(x, np.eye(14), 0.0, 1, likelihood, True)
    (((linear,), moved),) = linear_devices([fit], [[band]], INSTRUMENT, partial(moved_mechanics, True))
    loud = loud_samples(y)
    sizes = adc_sizes([loud], np.full(2, 1e-3), 5.0, True) | drive_sizes([band], True)
    (along,) = along_motions([linear], [band_motion(linear)], [loud], [sizes], True)
    found = signatures(linear, moved, True, feature_slopes(fit), along)

    def change(effect, parameter, value, **scanned):
        larger = model.with_effect(effect)
        moved = {**values, f"{effect}.{parameter}": value, **{f"{effect}.{name}": at for name, at in scanned.items()}}
        return band.transform(forward(larger, moved, record, INSTRUMENT) - y)

    by_effect = {}
    for one in found.signatures:
        by_effect.setdefault(one.effect, []).append(one)
    sensed = found.sensed[:, : band.bins.size] + 1j * found.sensed[:, band.bins.size :]
    return sensed, data.spectrum, by_effect, change


def test_the_linear_device_has_the_spectrum_of_its_record(device):
    sensed, spectrum, _, _ = device
    assert np.linalg.norm(sensed - spectrum) < 1e-10 * np.linalg.norm(spectrum)


@pytest.mark.parametrize(
    ("effect", "parameter", "size", "place"),
    [
        ("angular_rate", "Omega", 1e-4, 0),
        ("electrode_misalignment", "phi", 1e-4, 0),
        ("capacitive_feedthrough", "C_s1d2", 1e-9, 1),
        ("resistive_feedthrough", "R_s2d1", 1e-5, 2),
        ("pickoff_crosstalk", "b", 1e-5, 1),
        ("loop_delay", "tau", 1e-9, 0),
        ("pickoff_pole", "T", 1e-9, 0),
        ("cubic_stiffness", "k3", 1e6, 0),
        ("nonlinear_damping", "d", 1e-3, 0),
        ("damping_drift", "gamma", 1e-3, 0),
        ("frequency_drift", "beta", 1e-7, 0),
        ("gain_drift", "gamma", 1e-5, 0),
        ("channel_delay", "tau", 1e-9, 0),
        ("drive_delay", "tau", 1e-9, 0),
        ("clock_offset", "delta", 1e-3, 0),
        ("cubic_damping", "d", 1e-4, 0),
        ("squeeze_film_damping", "1/g^2", 1.0, 0),
        ("weakening_damping", "1/s", 1e-5, 0),
    ],
)
def test_a_signature_is_the_change_of_the_simulated_record(device, effect, parameter, size, place):
    _, _, found, change = device
    simulated, own = change(effect, parameter, size) / size, found[effect][place].spectrum
    scale = np.vdot(own, simulated).real / np.vdot(own, own).real
    # A share of a few percent survives the fit of most effects, so the shape must be right to a few tenths of a percent.
    assert np.linalg.norm(simulated - scale * own) < 0.013 * np.linalg.norm(simulated)
    assert scale == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("effect", "parameter", "size", "left"),
    [("gain_drift", "gamma", 1e-6, 0.005), ("drive_saturation", "1/level", 1.0 / (0.9 * np.abs(DRIVE).max()), 0.03)],
)
def test_a_change_with_a_jump_or_an_edge_at_the_ends_of_the_record_is_that_of_all_samples(
    device, effect, parameter, size, left
):
    """Envelopes at the points of the grid leave 1.2 % of t S, and 57 % of a drive that clips from the first sample on."""
    _, _, found, change = device
    simulated, own = change(effect, parameter, size) / size, found[effect][0].spectrum
    scale = np.vdot(own, simulated).real / np.vdot(own, own).real
    assert np.linalg.norm(simulated - scale * own) < left * np.linalg.norm(simulated)


@pytest.mark.parametrize(("place", "speed_v"), [(0, 0.05), (1, 0.2)])
def test_a_friction_that_is_viscous_in_quiet_parts_has_the_change_of_the_simulated_record(device, place, speed_v):
    """Its first harmonic needs more phases than that of a polynomial, and all points of the record."""
    _, _, found, change = device
    simulated, own = change("coulomb_friction", "F", 1e-5, s=speed_v) / 1e-5, found["coulomb_friction"][place].spectrum
    assert np.linalg.norm(simulated - own) < 0.013 * np.linalg.norm(simulated)


@pytest.mark.parametrize(
    ("effect", "parameter", "size", "place", "apart"),
    [
        ("quadratic_stiffness", "k2x", 5e7, 0, 0.02),
        ("quadratic_stiffness", "k2y", 5e7, 1, 0.02),
        ("sense_nonlinearity", "1/g", 10.0, 0, 0.02),
        ("electrostatic_softening", "1/g", 5.0, 0, 0.15),
    ],
)
def test_an_even_law_returns_into_the_band_in_second_order(device, effect, parameter, size, place, apart):
    _, _, found, change = device
    # The sum of both signs is free of the first order, which leaks into the band from its edges.
    simulated = (change(effect, parameter, size) + change(effect, parameter, -size)) / (2.0 * size**2)
    own = found[effect][place].spectrum
    scale = np.vdot(own, simulated).real / np.vdot(own, own).real
    assert np.linalg.norm(simulated - scale * own) < apart * np.linalg.norm(simulated)
    assert scale == pytest.approx(1.0, abs=0.05)


def test_laws_are_told_apart_by_their_parity():
    kinds = {probe.effect.name: kind_of(probe) for probe in probes_of(True, "force")}
    assert {name for name, kind in kinds.items() if kind.order == 2} == {
        "quadratic_stiffness",
        "electrostatic_softening",
        "levitation_force",
    }
    assert {name for name, kind in kinds.items() if kind.linear} == {"damping_drift", "frequency_drift"}
    assert kinds["quadratic_stiffness"].even


def test_the_fit_lacks_neither_its_own_effects_nor_what_lies_inside_them():
    names = {effect.name for effect in scored_effects(True)}
    assert not names & {"offdiagonal_damping", "electrode_mismatch", "updown_tilt"}
    assert {"electrode_mismatch", "updown_tilt"} <= {effect.name for effect in scored_effects(False)}


ROWS, PARAMETERS = 400, 5


def _linear_problem(random, absorbed=0.0):
    """Jacobian, one effect of one column and one of two, slopes of two quantities; ``absorbed`` of the first lies in the fit."""
    jacobian = random.standard_normal((ROWS, PARAMETERS))
    z = random.standard_normal((ROWS, 3))
    z[:, 0] = (1.0 - absorbed) * z[:, 0] + absorbed * 10.0 * jacobian @ np.ones(PARAMETERS)
    return jacobian, z, random.standard_normal((2, PARAMETERS))


def _judge(jacobian, z, slopes, data, low, high):
    residual = data - jacobian @ np.linalg.lstsq(jacobian, data, rcond=None)[0]
    whole = np.column_stack([jacobian, residual, z])
    products = whole.T @ whole
    fit = Projection.of(products[:PARAMETERS, :PARAMETERS], slopes)
    candidates = Candidates(("one", "two", "two"), np.array(low), np.array(high))
    return judged(EffectEvidence(products, fit, candidates, 1e9))


def test_p_values_are_uniform_and_bounds_hold_at_95_percent():
    random = np.random.default_rng(3)
    jacobian, z, slopes = _linear_problem(random)
    hidden = np.array([0.0, 0.15, -0.1])
    inverse = np.linalg.pinv(jacobian)
    bias = np.abs(slopes @ inverse @ z @ hidden)
    p_values, held = [], []
    for _ in range(400):
        noise = random.standard_normal(ROWS)
        p_values.append(_judge(jacobian, z, slopes, noise, [-9.0] * 3, [9.0] * 3).p_values)
        found = _judge(jacobian, z, slopes, noise + z @ hidden, [-9.0] * 3, [9.0] * 3)
        held.append(found.bounds[1] >= bias)
    for one in np.array(p_values).T:
        assert kstest(one, "uniform").pvalue > 1e-3
    # |b' a^| + 1.96 sd holds in at least 97.5 % of cases; 4 sd of a binomial share below that.
    assert np.all(np.mean(held, axis=0) > 0.975 - 4.0 * np.sqrt(0.025 / 400))


def test_an_effect_that_the_fit_absorbs_is_limited_by_its_range_only():
    random = np.random.default_rng(4)
    jacobian, z, slopes = _linear_problem(random, absorbed=1.0)
    found = _judge(jacobian, z, slopes, random.standard_normal(ROWS), [0.0, -9.0, -9.0], [0.7, 9.0, 9.0])
    assert found.p_values[0] == 1.0
    # z = 10 J 1, so a strength a moves each parameter by 10 a.
    np.testing.assert_allclose(found.bounds[0], np.abs(7.0 * slopes.sum(axis=1)), rtol=1e-6)


def test_a_one_sided_effect_is_no_explanation_of_the_other_sign():
    random = np.random.default_rng(5)
    jacobian, z, slopes = _linear_problem(random)
    data = -0.5 * z[:, 0] + random.standard_normal(ROWS)
    both = _judge(jacobian, z, slopes, data, [-9.0, -9.0, -9.0], [9.0, 9.0, 9.0])
    one = _judge(jacobian, z, slopes, data, [0.0, -9.0, -9.0], [9.0, 9.0, 9.0])
    assert both.p_values[0] < 1e-12
    assert one.p_values[0] == 1.0
    assert summary([both], ["a", "b"]).effect == "one"
    assert summary([both], ["a", "b"]).p_value == pytest.approx(2.0 * both.p_values[0])


@pytest.mark.parametrize(
    ("p_value", "bound", "status", "reason"),
    [
        (0.2, 0.9, "ok", None),
        (1e-4, 0.1, "misfit", "effect gain_drift is significant (p = 0.0001): run gyroscreen diagnose"),
        (0.2, 1.1, "misfit", "an undetected gain_drift could bias split_hz by 1.1, above 1"),
    ],
)
def test_the_gate_refuses_significant_effects_and_large_bounds(p_value, bound, status, reason):
    found = Undetected("gain_drift", p_value, {"split_hz": bound}, {"split_hz": "gain_drift"}, {"gain_drift": p_value})
    judged_status, why = status_of(
        GoodnessOfFit(1.0, 1000.0, 1000), 1e-4, Gate(bias_max={"split_hz": 1.0}), found=found
    )
    assert judged_status == status
    assert (why or "").startswith(reason or "")
    assert (why is None) == (reason is None)
