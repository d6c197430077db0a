"""Hidden-effects study: the simulator is accurate, SNRs are as requested, and the results are counted correctly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.arrays import FloatArray
from pipeline.criticism.budget import DETECTABLE_SNR
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.errors import ConfigError, UsageError
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.record import Record
from pipeline.inference.general.fit import fit_campaign
from pipeline.learning.campaign.answers import campaign_answers
from workflows.simulate import device_parameters
from workflows.studies.hidden import study
from workflows.studies.hidden.confusion import answer
from workflows.studies.hidden.draw import (
    INSTRUMENT,
    SIGMA_V,
    draw_device,
    effects_of,
    hide,
    inseparable,
    noise,
    stream,
)
from workflows.studies.hidden.effects import LIBRARY, Peak, draw_effect
from workflows.studies.hidden.integrator import STATES, integrate, lagged, size_of, slope
from workflows.studies.hidden.readout import APART
from workflows.studies.hidden.strengths import baseline, sized
from workflows.studies.hidden.truth import OUTSIDE, STATED, physics, response

_RATE = INSTRUMENT.sample_rate_hz
_DEVICE = device_parameters({}, 3)
#: Resonances are passed while the drive is strong, so every law has something to act on.
_SWEEP = drive_samples(Chirp((520.0, 545.0), (545.0, 520.0), duration_s=0.25), _RATE)


#: Compared one by one: those of single paths, and those that the simulator lets act on a force that others have changed.
ALONE = {*APART, "charge_drift", "drive_saturation", "levitation_force"}

#: Effects with an independent law that act within the integration, not on the samples.
CONTINUOUS = [n for n in LIBRARY if n in STATED - ALONE and not {"adc", "disturbance"} & set(Model().effect(n).stages)]


def _rms(y: FloatArray) -> float:
    return float(np.sqrt(np.mean(y**2)))


def _drawn(effect: str, size: float, seed: int = 0) -> dict[str, float]:
    drawn = draw_effect(effect, _DEVICE, Peak(2.0, 2.0), np.random.default_rng(seed))
    return drawn.at(min(size, drawn.most))


def _all_at_once() -> dict[str, float]:
    """Every effect of ``CONTINUOUS``."""
    strong = {"damping_drift": 30.0, "drive_nonlinearity": 2.0, "electrostatic_softening": 1.0}
    drawn = {name: value for effect in CONTINUOUS for name, value in _drawn(effect, strong.get(effect, 10.0)).items()}
    # Two steps per sample resolve the corner of a narrower friction, and those of a hysteresis, to 1e-7 only.
    return {**drawn, "coulomb_friction.s": 0.3, "hysteresis.k": 3.0}


def test_the_study_hides_every_library_effect_and_states_library_laws_only() -> None:
    assert set(LIBRARY) == set(Model().candidates())
    assert set(LIBRARY) >= STATED
    assert not set(OUTSIDE) & set(LIBRARY)


def test_smaller_integration_steps_change_the_response_by_less_than_1e_8() -> None:
    values = {**_DEVICE, **_all_at_once()}
    fine = response(values, _SWEEP, INSTRUMENT, steps=8)
    assert _rms(response(values, _SWEEP, INSTRUMENT) - fine) < 1e-8 * _rms(fine)


@pytest.mark.parametrize("effect", ["library", "hysteresis", *OUTSIDE])
def test_the_simulator_agrees_with_an_adaptive_solver(effect: str) -> None:
    """DOP853 at rtol 1e-11 hold by hold; a hysteresis has corners that no fixed step resolves."""
    sizes = _all_at_once() if effect == "library" else _drawn(effect, 20.0)
    # Lags behind the filter and impulses are added to the solver's answer elsewhere.
    late = ("pickoff_pole.T", "loop_delay.tau")
    values = {**_DEVICE, **{n: v for n, v in sizes.items() if n not in late and "capacitive" not in n}}
    # A stop is reached and a hysteresis turns only after some periods of growth.
    v = _SWEEP[1000 : 1400 if effect in ("hysteresis", "stop") else 1200]
    g = physics(values, INSTRUMENT)
    y, expected = np.zeros(size_of(g)), np.zeros((v.shape[0], 2))

    def rate(t: float, state: FloatArray, drive: FloatArray) -> FloatArray:
        out = np.zeros(state.size)
        slope(t, state, drive, g, out)
        return out

    for n in range(v.shape[0]):
        expected[n] = y[[STATES - 10, STATES - 2]]
        span = (n / _RATE, (n + 1) / _RATE)
        y = solve_ivp(rate, span, y, "DOP853", rtol=1e-11, atol=1e-14, args=(v[n],)).y[:, -1]
    found = integrate(v, 1.0 / _RATE, 2, g)
    assert _rms(found - expected) < (1e-6 if effect in ("hysteresis", "stop") else 1e-7) * _rms(expected)


def test_the_lag_equals_a_first_order_low_pass() -> None:
    omega, lag, h = 2.0 * np.pi * 600.0, 3e-6, 5e-5

    def at(t: float) -> FloatArray:
        return np.array([np.cos(omega * t), -omega * np.sin(omega * t), -(omega**2) * np.cos(omega * t)])

    p = 0.0
    for n in range(200):
        p = lagged(p, at(n * h), at((n + 1) * h), h, lag)
    assert p == pytest.approx(np.real(np.exp(1j * omega * 200 * h) / (1.0 + 1j * omega * lag)), abs=1e-9)


@pytest.mark.parametrize(
    "effect", [*(e for e in LIBRARY if e in STATED and Model().effect(e).disturbance is None), "all"]
)
def test_simulator_and_model_agree_on_every_law(effect: str) -> None:
    """Two programs that share no code: one exact linear propagator with a deviation, one plain integrator."""
    sizes = _all_at_once() if effect == "all" else _drawn(effect, 10.0)
    sizes.pop("adc_saturation.clips_noise", None)
    model = Model(effects=tuple(CONTINUOUS) if effect == "all" else (effect,))
    names = model.by_name
    parameters = {n: v for n, v in {**_DEVICE, **sizes}.items() if n in names}
    record = Record("sweep", _RATE, _SWEEP, np.zeros_like(_SWEEP))
    found = forward(model, parameters, record, INSTRUMENT)
    true = response({**_DEVICE, **sizes}, _SWEEP, INSTRUMENT)
    without = response(_DEVICE, _SWEEP, INSTRUMENT)
    moved = _rms(true - without)
    assert moved > 1e-7 * _rms(true)
    assert _rms(found - true) < 1e-6 * _rms(true)
    assert _rms(found - true) < 0.02 * moved


def test_the_size_gives_the_requested_snr() -> None:
    records = [Record("sweep", _RATE, _SWEEP, np.zeros_like(_SWEEP), role="fit")]
    base = baseline(_DEVICE, records, INSTRUMENT, SIGMA_V)
    before = response(_DEVICE, _SWEEP, INSTRUMENT)

    def snr_of(size: float) -> float:
        return base.snr([response({**_DEVICE, **_drawn("cubic_stiffness", size)}, _SWEEP, INSTRUMENT) - before])

    found = sized(snr_of, 30.0, 1e6)
    assert found.snr == pytest.approx(30.0, rel=0.16)
    assert snr_of(found.size) == found.snr
    # What the plant's own parameters can do is no effect at all.
    moved = response(
        {**_DEVICE, "f1_hz": _DEVICE["f1_hz"] * (1.0 + 1e-9), "zeta3": 1.0001 * _DEVICE["zeta3"]}, _SWEEP, INSTRUMENT
    )
    assert base.snr([moved - before]) < 1e-3 * np.linalg.norm(moved - before) / SIGMA_V


def test_sized_reaches_the_snr_of_steep_limited_and_diverging_effects() -> None:
    assert sized(lambda s: s**3, 100.0, 1e9).snr == pytest.approx(100.0, rel=0.16)
    assert sized(lambda s: s, 100.0, 20.0).size == 20.0

    def diverging(size: float) -> float:
        if size > 0.5:
            raise ConfigError("the motion diverges")
        return 1e4 * size

    assert sized(diverging, 100.0, 1e9).snr == pytest.approx(100.0, rel=0.16)


@pytest.mark.usefixtures("short_records")
def test_the_same_seed_kind_and_number_give_the_same_campaign() -> None:
    number = LIBRARY.index("cubic_stiffness")
    first, again, other = hide("one", number, 7), hide("one", number, 7), hide("one", number + len(LIBRARY), 7)
    assert first.values == again.values
    assert first.snr == again.snr
    assert first.effects == other.effects == ("cubic_stiffness",)
    assert first.values != other.values
    for a, b in zip(first.campaign.records, again.campaign.records):
        assert np.array_equal(a.sense_v, b.sense_v)
    assert [record.role for record in first.campaign.records] == ["noise"] + 6 * ["fit"] + ["validate"]
    assert first.sizes == ("cubic_stiffness.k3",)


@pytest.mark.usefixtures("short_records")
def test_samples_exceed_the_clip_level_only_where_noise_is_added_after_clipping() -> None:
    found = {}
    first, count = LIBRARY.index("adc_saturation"), len(LIBRARY)
    for number in range(first, 12 * count, count):
        hidden = hide("one", number, 1)
        level = 1.0 / hidden.values["adc_saturation.1/level"]
        peak = max(float(np.abs(r.sense_v).max()) for r in hidden.campaign.records)
        found[hidden.values["adc_saturation.clips_noise"]] = peak - level
    lsb = 20.0 / 2**16
    assert found[1.0] <= 0.5 * lsb
    assert found[0.0] > lsb


@pytest.mark.usefixtures("brief_records")
def test_a_mechanical_stop_is_reached_although_the_up_down_motion_is_larger() -> None:
    first = list(OUTSIDE).index("stop")
    assert all(10.0 < hide("outside", first + k * len(OUTSIDE), 5).snr[0] < 1000.0 for k in (2, 6))


def test_effects_are_hidden_in_turn_and_pairs_are_separable() -> None:
    random = np.random.default_rng(1)
    assert [effects_of("one", n, random)[0] for n in range(len(LIBRARY))] == list(LIBRARY)
    pairs = [set(effects_of("two", n, random)) for n in range(300)]
    assert all(len(pair) == 2 for pair in pairs)
    assert {"pickoff_pole", "loop_delay"} not in pairs
    assert {"updown_tilt", "electrode_mismatch"} not in pairs
    assert not inseparable("parasitic_mode", "capacitive_feedthrough")
    assert max(draw_device(stream(0, "one", n, "x"))["zeta1"] for n in range(20)) < 1.0 / 1200.0
    with pytest.raises(UsageError):
        hide("nonsense", 0, 0)


@pytest.mark.parametrize("kind", ["white", "coloured", "heavy-tailed", "louder"])
def test_noise_has_the_declared_sd_and_distribution(kind: Any) -> None:
    n = noise(kind, False, 200_000, np.random.default_rng(5)) / SIGMA_V
    assert np.std(n) == pytest.approx(1.2 if kind == "louder" else 1.0, rel=0.02)
    assert np.std(noise("louder", True, 200_000, np.random.default_rng(5))) == pytest.approx(SIGMA_V, rel=0.01)
    neighbours = np.mean(n[1:] * n[:-1]) / np.var(n)
    assert neighbours == pytest.approx(0.7 if kind == "coloured" else 0.0, abs=0.01)
    kurtosis = np.mean(n**4) / np.var(n) ** 2
    assert (kurtosis > 4.0) == (kind == "heavy-tailed")


def test_an_instrument_without_antialias_filter_is_refused() -> None:
    with pytest.raises(ConfigError):
        physics(_DEVICE, replace(INSTRUMENT, antialias=None))


@pytest.mark.usefixtures("brief_records")
@pytest.mark.parametrize(
    ("kind", "number", "expected"),
    [
        ("none", 0, "adequate"),
        ("one", LIBRARY.index("pickoff_pole"), "right"),
        ("outside", list(OUTSIDE).index("self_heating"), "unknown"),
        ("left-out", LIBRARY.index("sense_nonlinearity"), "unknown"),
    ],
)
def test_the_diagnosis_of_each_kind_of_campaign_is_the_expected_one(kind: str, number: int, expected: str) -> None:
    hidden = hide(kind, number, 2026)
    row = study.examine(hidden)
    assert answer(row, "diagnose") == expected, row


@pytest.mark.usefixtures("brief_records")
def test_adding_the_hidden_effect_explains_the_held_out_records() -> None:
    row = study.examine(hide("one", LIBRARY.index("cubic_stiffness"), 2026))
    assert not row["failed"]
    assert answer(row, "diagnose") == answer(row, "refine") == "right"
    assert row["refine"]["ladder"][0]["error_validate"] > 1.01
    # 1.3 % is two sd of the noise level that one second of silence gives.
    assert row["refine"]["ladder"][-1]["error_validate"] < 1.013
    assert row["refine"]["snr_left"] < DETECTABLE_SNR


@pytest.mark.usefixtures("brief_records")
def test_without_the_hidden_effect_a_fit_leaves_the_snr_that_was_drawn() -> None:
    hidden = hide("one", LIBRARY.index("cubic_stiffness"), 2026)
    problem = campaign_answers(hidden.campaign).problem
    problem.fit(())
    assert study.snr_left(problem.campaign_fit(()), hidden) == pytest.approx(hidden.snr[0], rel=0.15)


@pytest.mark.usefixtures("brief_records")
def test_a_fit_of_a_nonlinear_law_reaches_the_minimum() -> None:
    # The inverse gap is far from its estimate at the null, so the first signatures no longer hold at the minimum.
    hidden = hide("one", LIBRARY.index("electrostatic_softening") + 2 * len(LIBRARY), 4)
    assert hidden.effects == ("electrostatic_softening",)
    view = campaign_answers(hidden.campaign).problem
    view.fit(())
    view.fit(hidden.effects)
    found = view.campaign_fit(hidden.effects)
    model = DEFAULT_COMPARE_MODEL.with_effect(*hidden.effects)
    truth = {name: hidden.values[name] for name in model.free if name in hidden.values}
    from_truth = fit_campaign(model, hidden.campaign, view.noise, truth)
    assert found.converged
    assert found.chi2 < from_truth.chi2 + 0.1
