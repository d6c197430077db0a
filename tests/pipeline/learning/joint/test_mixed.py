"""One device in time and in frequency: both parts are fitted together, with one set of parameters."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from pipeline.criticism.budget import CLEAR_SNR
from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import as_ladder
from pipeline.criticism.verdict import TermClass
from pipeline.device.model import Model, PlantSpec
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Campaign, Record
from pipeline.experiment.tones import ToneCampaign, ToneRecord
from pipeline.learning.joint.answers import joint_answers
from pipeline.learning.joint.terms import terms_of
from workflows.learning import compare, refine

F0, WIDTH, GAIN, RATE = 300.0, 5.0, 40.0, 10_000.0
MODEL = Model(PlantSpec("modal", 1, "velocity"))
TRUE = {"f1_hz": F0, "zeta1": WIDTH / (2 * F0), "gain1_s1d1": GAIN}


@njit(cache=True)
def _sampled(drive, rate, w0, width, gain, k3, steps):
    """x'' + width x' + w0^2 x + k3 x^3 = gain u, u held between samples, by Runge-Kutta: no code of the package."""
    out = np.zeros(drive.size)
    x, v, h = 0.0, 0.0, 1.0 / rate / steps
    for n in range(drive.size):
        out[n] = v
        for _ in range(steps):
            x1, v1 = v, gain * drive[n] - width * v - w0**2 * x - k3 * x**3
            xa, va = x + 0.5 * h * x1, v + 0.5 * h * v1
            x2, v2 = va, gain * drive[n] - width * va - w0**2 * xa - k3 * xa**3
            xb, vb = x + 0.5 * h * x2, v + 0.5 * h * v2
            x3, v3 = vb, gain * drive[n] - width * vb - w0**2 * xb - k3 * xb**3
            xc, vc = x + h * x3, v + h * v3
            x4, v4 = vc, gain * drive[n] - width * vc - w0**2 * xc - k3 * xc**3
            x += h / 6.0 * (x1 + 2.0 * x2 + 2.0 * x3 + x4)
            v += h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
    return out


def chirp(level, sd, k3=0.0, seed=1, seconds=0.8, hum=0.0, clip=np.inf, f0=F0):
    """Two chirps up and down, fitted and held out, and a silent record; volts of a 50 Hz line, and a level of clipping."""
    t = np.arange(int(seconds * RATE)) / RATE
    up = level * np.sin(2 * np.pi * (260.0 * t + 40.0 * t**2 / seconds))
    random, records = np.random.default_rng(seed), []
    for name, drive, role in (("up", up, "fit"), ("down", up[::-1].copy(), "validate"), ("silent", 0.0 * up, "noise")):
        y = _sampled(drive, RATE, 2 * np.pi * f0, 2 * np.pi * WIDTH, GAIN, k3, 8)
        y = y + sd * random.standard_normal(t.size) + hum * np.cos(100 * np.pi * t + random.uniform(0.0, 2 * np.pi))
        y = np.clip(y, -clip, clip)
        records.append(Record(name, RATE, drive[:, None], y[:, None], role=role))
    return Campaign("mixed", tuple(records), Instrument(RATE))


def sweep(level, sd, k3=0.0, seed=2, rows=50):
    """Sweeps up and down, twice, on the branches of the averaged Duffing equation."""
    f = np.linspace(F0 - 3 * WIDTH, F0 + 3 * WIDTH, rows)
    frequency = np.concatenate([f, f[::-1], f, f[::-1]])
    w, w0 = 2 * np.pi * frequency, 2 * np.pi * F0
    q, state = np.zeros(frequency.size, complex), 0.0j
    for i, one in enumerate(w):
        for _ in range(4000 if k3 else 1):
            own = w0**2 - one**2 + 0.75 * k3 * abs(state) ** 2 + 1j * one * 2 * np.pi * WIDTH
            new = GAIN * level / own
            state = new if not k3 else 0.9 * state + 0.1 * new
        q[i] = state
    y = (1j * w * q + 0.3 * sd) * np.exp(1j * np.deg2rad(20.0))
    random = np.random.default_rng(seed)
    y = y + sd * (random.standard_normal(y.size) + 1j * random.standard_normal(y.size))
    drive = np.full((y.size, 1), level + 0j)
    first, last = slice(0, 2 * rows), slice(2 * rows, None)
    return tuple(
        ToneRecord(name, "sweep", frequency[r], drive[r], y[r, None], sd_v=np.full((2 * rows, 1), sd), role=role)
        for name, r, role in (("sweep", first, "fit"), ("again", last, "validate"))
    )


def mixed(timed, records):
    return ToneCampaign("mixed", records, timed.instrument if timed else Instrument(1.0), timed=timed)


def covariance(fit, names):
    """Of the parameters ``names`` from the columns of a fit, whatever else was fitted."""
    gram = sum(block.T @ block for block in fit.jacobian)
    places = [list(fit.parameters).index(name) for name in names]
    return np.linalg.inv(gram)[np.ix_(places, places)]


def test_the_parts_agree_and_their_information_adds_up():
    timed, records = chirp(0.02, 2e-3), sweep(0.01, 2e-4)
    names = list(TRUE)
    time, tones = compare(timed, MODEL), compare(mixed(None, records), MODEL)
    joint = compare(mixed(timed, records), MODEL)
    assert joint.answer.fit_ok
    assert 0.9 < joint.answer.error["fit"] < 1.1
    assert 0.85 < joint.answer.error["validate"] < 1.15
    assert [record.role for record in joint.answer.records.values()].count("validate") == 2
    information, moment = np.zeros((3, 3)), np.zeros(3)
    for fit in (time.problem.fit(()), tones.fit):
        own = np.linalg.inv(covariance(fit, names))
        information += own
        moment += own @ [fit.parameters[name][0] for name in names]
    expected, spread = np.linalg.solve(information, moment), np.linalg.inv(information)
    for k, (name, true) in enumerate(TRUE.items()):
        value, sd = joint.answer.parameters[name]
        alone = [one.answer.parameters[name][1] for one in (time, tones)]
        assert sd < 0.95 * min(alone), name
        assert sd == pytest.approx(np.sqrt(spread[k, k]), rel=0.03), name
        assert abs(value - expected[k]) < 0.2 * sd, name
        assert abs(value - true) < 4.0 * sd, name


def refined(timed, records, monkeypatch):
    """The answers and the ladder of one rung, without the terms of which a scan takes most of the time.

    A mode at each of 60 frequencies is no rival of a force, of hum and of clipping.
    """

    def plain(*given):
        found = tuple(term for term in terms_of(*given) if not term.scanned or not term.has_slope)
        assert len(found) > 6
        return found

    monkeypatch.setattr("pipeline.learning.joint.problem.terms_of", plain)
    answers, rules = joint_answers(mixed(timed, records), MODEL), Rules(rungs=1)
    answers, selection = answers.selected(rules)
    return answers, as_ladder(answers.problem, selection, rules)


@pytest.mark.parametrize("shown", ["sweep", "chirp"])
def test_an_effect_that_one_part_shows_is_named(shown, monkeypatch):
    """A cubic stiffness that bends the resonance of one part by half its width and of the other not at all."""
    k3, levels = 6e14, {"sweep": 0.001, "chirp": 0.002}
    levels[shown] *= 15.0
    timed, records = chirp(levels["chirp"], 2e-4, k3, seconds=0.4), sweep(levels["sweep"], 2e-5, k3, rows=40)
    answers, ladder = refined(timed, records, monkeypatch)
    assert (ladder.verdict, ladder.terms) == ("adequate", ("cubic_stiffness",))
    assert ladder.rungs[-1].status == "confirmed"
    value, sd = ladder.rungs[-1].parameters["cubic_stiffness.k3"]
    assert abs(value - k3) < 4.0 * sd
    (place,) = [p for p in answers.refinement(ladder).regions if p.family == "record" and p.share > 0.5]
    assert place.record == ("sweep" if shown == "sweep" else "up")


@pytest.mark.parametrize("effect", ["mains_hum", "adc_saturation"])
def test_what_the_instrument_of_the_time_records_does_is_named(effect, monkeypatch):
    """A 50 Hz line of 5 sigma, or peaks cut at 0.9 of their height; a sweep has neither, and its rows stay as they are."""
    sd, clip = (
        1e-3 if effect == "mains_hum" else 1e-4,
        0.9 * np.abs(chirp(0.02, 0.0, seconds=0.4).records[0].sense_v).max(),
    )
    hidden = {"hum": 5.0 * sd} if effect == "mains_hum" else {"clip": clip}
    answers, ladder = refined(chirp(0.02, sd, seconds=0.4, **hidden), sweep(0.001, 2e-5, rows=40), monkeypatch)
    assert (ladder.verdict, ladder.terms) == ("adequate", (effect,))
    assert ladder.rungs[-1].status == "confirmed"
    found = ladder.rungs[-1].parameters
    if effect == "mains_hum":
        assert found["mains_hum.f"] == (50.0, 0.0)
    else:
        value, spread = found["adc_saturation.1/level"]
        assert abs(value - 1.0 / clip) < 4.0 * spread
    values, tones = answers.problem.values(answers.fitted((effect,))), answers.problem.parts[1]
    for one, other in zip(
        tones.predict(values), tones.predict({**values, **{name: 0.0 for name in found if "." in name}})
    ):
        assert np.array_equal(one, other)


def test_the_gain_does_not_depend_on_the_size_of_the_drive():
    """A candidate that clips the drive is at its null: on grid values it clipped sweeps of more than 10 V."""
    fit = compare(mixed(None, sweep(40.0, 0.01)), MODEL).fit
    value, sd = fit.parameters["gain1_s1d1"]
    assert abs(value - GAIN) < 4.0 * sd


def test_repeats_whose_frequency_differs_by_3_ppm_are_aligned():
    """With every candidate of the library; the sweep has one frequency, that between the two."""
    plain, warm = chirp(0.02, 3e-6, seed=1), chirp(0.02, 3e-6, seed=5, f0=F0 * (1.0 + 3e-6))
    again = replace(warm.records[0], name="again")
    timed = replace(plain, records=(*plain.records, again))
    result = refine(mixed(timed, sweep(0.001, 2e-5, rows=40)), MODEL)
    assert (result.verdict, result.effects) == ("adequate", ())
    found = result.answers.comparison
    assert 0.9 < found.error["fit"] < 1.1
    assert found.records_differ.text == ("All natural frequencies rose by 3 ppm from up to again.",)
    assert found.records_differ.text[0] in str(result)
    for name, true in TRUE.items():
        value, sd = found.parameters[name]
        assert abs(value - true) < 4.0 * sd + (1.5e-6 * F0 if name == "f1_hz" else 0.0), name


def test_the_proposed_record_separates_what_a_sweep_cannot_as_well_as_predicted():
    """A softening that is cubic or, on tones, quadratic: the rise of chi2 with the wrong one once the record is measured."""
    k3, pair = -3e14, ("cubic_stiffness", "quadratic_stiffness")
    timed, records = chirp(0.004, 2e-4, k3, seconds=0.4), sweep(0.01, 2e-5, k3, rows=40)
    problem = joint_answers(mixed(timed, records), MODEL).problem
    right, wrong = (problem.fit((name,), problem.fit(())) for name in pair)
    proposal = problem.proposal(pair[:1], TermClass(pair[0], pair, ()))
    record = proposal.experiment.record(timed)
    true = problem.campaign_fit(pair[:1])
    measured = replace(record, sense_v=forward(true.model, true.values, record, timed.instrument))
    whole = mixed(replace(timed, records=(*timed.records, measured)), records)
    refit = joint_answers(whole, MODEL).problem.fit(pair[1:], wrong)
    assert abs(wrong.chi2 - right.chi2) < 10.0
    assert proposal.snr > CLEAR_SNR
    assert refit.chi2 - right.chi2 == pytest.approx(proposal.snr**2, rel=0.05)
    declared = tomllib.loads(proposal.stanza())["record"][0]
    assert (declared["kind"], declared["columns"]) == ("time", {})
