"""Hidden-effect campaigns: the truth is true, strengths are what they say, the books are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.arrays import FloatArray
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.errors import ConfigError, UsageError
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.record import Record
from pipeline.inference.general.fit import fit_campaign
from workflows.commands.hidden import lines
from workflows.learning import view_of
from workflows.simulate import device_parameters, standard_excitations
from workflows.studies.coverage import Share
from workflows.studies.hidden import draw, study
from workflows.studies.hidden.confusion import answer, confusion, figures, main_parameter, power
from workflows.studies.hidden.draw import INSTRUMENT, KINDS, SIGMA_V, device, effects_of, hide, noise, stream
from workflows.studies.hidden.effects import LIBRARY, Peak, draw_effect
from workflows.studies.hidden.integrator import STATES, integrate, lagged, slope
from workflows.studies.hidden.strengths import baseline, sized
from workflows.studies.hidden.truth import OUTSIDE, physics, response

_RATE = INSTRUMENT.sample_rate_hz
_DEVICE = device_parameters({}, 3)
#: Resonances are passed while the drive is strong, so every law has something to act on.
_SWEEP = drive_samples(Chirp((520.0, 545.0), (545.0, 520.0), duration_s=0.25), _RATE)


def _rms(y: FloatArray) -> float:
    return float(np.sqrt(np.mean(y**2)))


def _drawn(effect: str, size: float, seed: int = 0) -> dict[str, float]:
    drawn = draw_effect(effect, _DEVICE, Peak(2.0, 2.0), np.random.default_rng(seed))
    return drawn.at(min(size, drawn.most))


def _all_at_once() -> dict[str, float]:
    """Every continuous-time effect at once; a converter and lines of the mains come behind it."""
    strong = {"damping_drift": 30.0, "drive_nonlinearity": 2.0, "electrostatic_softening": 1.0}
    return {
        name: value
        for effect in LIBRARY
        if effect not in ("adc_saturation", "mains_hum")
        for name, value in _drawn(effect, strong.get(effect, 10.0)).items()
    }


def test_every_hidden_effect_of_the_library_is_a_library_effect() -> None:
    assert set(LIBRARY) == set(Model().candidates())
    assert not set(OUTSIDE) & set(LIBRARY)


def test_smaller_steps_change_nothing() -> None:
    values = {**_DEVICE, **_all_at_once()}
    fine = response(values, _SWEEP, INSTRUMENT, steps=8)
    assert _rms(response(values, _SWEEP, INSTRUMENT) - fine) < 1e-8 * _rms(fine)


@pytest.mark.parametrize("effect", ["library", *OUTSIDE])
def test_truth_is_what_an_adaptive_solver_gives(effect: str) -> None:
    """DOP853 at rtol 1e-11 hold by hold; friction and hysteresis have corners that no fixed step resolves."""
    sizes = _all_at_once() if effect == "library" else _drawn(effect, 20.0)
    # Lags behind the filter and impulses are added to the solver's answer elsewhere.
    late = ("pickoff_pole.T", "loop_delay.tau")
    values = {**_DEVICE, **{n: v for n, v in sizes.items() if n not in late and "capacitive" not in n}}
    v = _SWEEP[1000:1400]
    g = physics(values, INSTRUMENT)
    y, expected = np.zeros(STATES), np.zeros((v.shape[0], 2))

    def rate(t: float, state: FloatArray, drive: FloatArray) -> FloatArray:
        out = np.zeros(STATES)
        slope(t, state, drive, g, out)
        return out

    for n in range(v.shape[0]):
        expected[n] = y[[STATES - 10, STATES - 2]]
        span = (n / _RATE, (n + 1) / _RATE)
        y = solve_ivp(rate, span, y, "DOP853", rtol=1e-11, atol=1e-14, args=(v[n],)).y[:, -1]
    found = integrate(v, 1.0 / _RATE, 2, g)
    assert _rms(found - expected) < (1e-6 if effect in ("hysteresis", "stop") else 1e-7) * _rms(expected)


def test_lag_of_a_wave_is_a_first_order_low_pass() -> None:
    omega, lag, h = 2.0 * np.pi * 600.0, 3e-6, 5e-5

    def at(t: float) -> FloatArray:
        return np.array([np.cos(omega * t), -omega * np.sin(omega * t), -(omega**2) * np.cos(omega * t)])

    p = 0.0
    for n in range(200):
        p = lagged(p, at(n * h), at((n + 1) * h), h, lag)
    assert p == pytest.approx(np.real(np.exp(1j * omega * 200 * h) / (1.0 + 1j * omega * lag)), abs=1e-9)


@pytest.mark.parametrize("effect", [*(e for e in LIBRARY if e != "mains_hum"), "all"])
def test_truth_and_model_agree_on_every_law(effect: str) -> None:
    """Two programs that share no code: one exact linear propagator with a deviation, one plain integrator."""
    sizes = _all_at_once() if effect == "all" else _drawn(effect, 10.0)
    sizes.pop("adc_saturation.clips_noise", None)
    model = Model(effects=tuple(e for e in LIBRARY if e != "adc_saturation") if effect == "all" else (effect,))
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


def test_strengths_are_hit() -> None:
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


def test_sizes_are_found_on_steep_and_capped_scales() -> None:
    assert sized(lambda s: s**3, 100.0, 1e9).snr == pytest.approx(100.0, rel=0.16)
    assert sized(lambda s: s, 100.0, 20.0).size == 20.0

    def diverging(size: float) -> float:
        if size > 0.5:
            raise ConfigError("the motion diverges")
        return 1e4 * size

    assert sized(diverging, 100.0, 1e9).snr == pytest.approx(100.0, rel=0.16)


@pytest.fixture
def short_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """The standard campaign with records of 0.1 s."""
    short = [(name, role, replace(e, duration_s=0.1)) for name, role, e in standard_excitations(1)[:-1]]
    monkeypatch.setattr(draw, "standard_excitations", lambda seed: short)


@pytest.mark.usefixtures("short_records")
def test_a_campaign_is_decided_by_seed_kind_and_number() -> None:
    first, again, other = hide("one", 3, 7), hide("one", 3, 7), hide("one", 25, 7)
    assert first.values == again.values
    assert first.snr == again.snr
    assert first.effects == other.effects == ("cubic_stiffness",)
    assert first.values != other.values
    for a, b in zip(first.campaign.records, again.campaign.records):
        assert np.array_equal(a.sense_v, b.sense_v)
    assert [record.role for record in first.campaign.records] == ["noise"] + 6 * ["fit"] + ["validate"]
    assert first.sizes == ("cubic_stiffness.k3",)


@pytest.mark.usefixtures("short_records")
def test_noise_that_a_converter_clips_stays_below_its_level() -> None:
    found = {}
    for number in range(0, 22 * 12, 22):
        hidden = hide("one", number, 1)
        level = 1.0 / hidden.values["adc_saturation.1/level"]
        peak = max(float(np.abs(r.sense_v).max()) for r in hidden.campaign.records)
        found[hidden.values["adc_saturation.clips_noise"]] = peak - level
    lsb = 20.0 / 2**16
    assert found[1.0] <= 0.5 * lsb
    assert found[0.0] > lsb


def test_a_stop_is_met_where_the_up_down_motion_is_the_larger_one() -> None:
    assert all(10.0 < hide("outside", number, 5).snr[0] < 1000.0 for number in (14, 38))


def test_each_in_turn_and_pairs_that_can_be_told_apart() -> None:
    random = np.random.default_rng(1)
    assert [effects_of("one", n, random)[0] for n in range(22)] == list(LIBRARY)
    pairs = [set(effects_of("two", n, random)) for n in range(300)]
    assert all(len(pair) == 2 for pair in pairs)
    assert {"pickoff_pole", "loop_delay"} not in pairs
    assert max(device(stream(0, "one", n, "x"))["zeta1"] for n in range(20)) < 1.0 / 1200.0
    with pytest.raises(UsageError):
        hide("nonsense", 0, 0)


@pytest.mark.parametrize("kind", ["white", "coloured", "heavy-tailed", "louder"])
def test_noise_has_its_size_and_its_shape(kind: Any) -> None:
    n = noise(kind, False, 200_000, np.random.default_rng(5)) / SIGMA_V
    assert np.std(n) == pytest.approx(1.2 if kind == "louder" else 1.0, rel=0.02)
    assert np.std(noise("louder", True, 200_000, np.random.default_rng(5))) == pytest.approx(SIGMA_V, rel=0.01)
    neighbours = np.mean(n[1:] * n[:-1]) / np.var(n)
    assert neighbours == pytest.approx(0.7 if kind == "coloured" else 0.0, abs=0.01)
    kurtosis = np.mean(n**4) / np.var(n) ** 2
    assert (kurtosis > 4.0) == (kind == "heavy-tailed")


def _row(kind: str, number: int, hidden: list[str], **found: Any) -> dict[str, Any]:
    step = {"verdict": "adequate", "effects": [], "classes": [], "seconds": 3.0, "cpu_seconds": 2.0, **found}
    ladder = [{"status": None, "error_validate": 2.0}, {"status": "confirmed", "error_validate": 1.0}]
    refined = kind in ("one", "two", "outside", "left-out")
    selection = {
        **step,
        "ladder": ladder if step["effects"] else ladder[:1],
        "theta_deg": [10.0, 0.1],
        "theta_before_deg": [11.0, 0.1],
        "split_hz": [2.0, 0.1],
        "parameters": {"cubic_stiffness.k3": [1.1, 0.1]},
        "verdict": "adequate" if step["verdict"] == "effect" else step["verdict"],
    }
    return {
        "kind": kind,
        "number": number,
        "seed": 1,
        "hidden": hidden,
        "left_out": hidden if kind == "left-out" else [],
        "snr": [9.0] * len(hidden),
        "sizes": {"cubic_stiffness.k3": 1.0},
        "truth": {"theta_deg": 10.05, "split_hz": 2.5},
        "diagnose": step,
        "refine": selection if refined else None,
        "failed": "",
    }


def test_answers_are_judged_with_their_classes() -> None:
    k, d = "cubic_stiffness", "drive_nonlinearity"
    assert answer(_row("one", 0, [k], verdict="effect", effects=[k]), "diagnose") == "right"
    assert answer(_row("one", 0, [k], verdict="class", effects=[d], classes=[[d, k]]), "diagnose") == "right"
    large = [[d, k, "gain_drift", "loop_delay"]]
    assert answer(_row("one", 0, [k], verdict="class", effects=[d], classes=large), "diagnose") == "partly"
    assert answer(_row("one", 0, [k], verdict="effect", effects=[d]), "diagnose") == "wrong"
    assert answer(_row("one", 0, [k], verdict="effect", effects=[k, d]), "diagnose") == "wrong"
    assert answer(_row("two", 0, [k, d], verdict="effect", effects=[k]), "refine") == "partly"
    assert answer(_row("two", 0, [k, d], verdict="effect", effects=[k, d]), "refine") == "right"
    assert answer(_row("one", 0, [k], verdict="unknown", effects=[d]), "refine") == "unknown"
    assert answer(_row("weak", 0, [k]), "diagnose") == "adequate"


def test_figures_count_what_they_say() -> None:
    k, d = "cubic_stiffness", "drive_nonlinearity"
    rows = [
        _row("none", 0, []),
        _row("none", 1, [], verdict="effect", effects=[d]),
        _row("one", 0, [k], verdict="effect", effects=[k]),
        _row("one", 1, [k], verdict="effect", effects=[d]),
        _row("left-out", 0, ["loop_delay"], verdict="effect", effects=["pickoff_pole"]),
        _row("left-out", 1, ["loop_delay"], verdict="unknown"),
        replace_failed(_row("weak", 0, [k])),
    ]
    found = figures(rows)
    assert found["campaigns that failed to run"] == 1
    assert found["none: a name (at most 1 %)"] == Share(1, 2)
    assert found["one: right, diagnose (at least 95 %)"] == Share(1, 2)
    assert found["one: wrong name, refine (at most 1 %)"] == Share(1, 2)
    assert found["left-out: unknown, no confirmed rung (at least 90 %)"] == Share(1, 1)
    assert found["left-out: a look-alike stands for it, excused"] == 1
    assert found["after adding: theta_deg inside its 90 % interval (85 to 95 %)"] == Share(1, 1)
    assert found["after adding: split_hz inside its 90 % interval (85 to 95 %)"] == Share(0, 1)
    assert found["before adding: theta_deg off by more than 3 sd"] == Share(1, 1)
    assert found["size: inside its 95 % interval (91 to 98 %)"] == Share(1, 1)
    assert main_parameter(rows[3]) is None
    assert confusion(rows, "diagnose")["one: cubic_stiffness"] == {k: 1, d: 1}
    assert sum(sum(counts.values()) for _, _, counts in power(rows)) == 2
    said = "\n".join(lines(rows))
    assert "none 1 seed 1  nothing" in said
    assert "one 0 seed 1" not in said


def replace_failed(row: dict[str, Any]) -> dict[str, Any]:
    return {**row, "failed": "ValueError: no", "diagnose": None, "refine": None}


def test_a_study_goes_on_where_it_was(tmp_path: Path) -> None:
    study.append(tmp_path, _row("none", 0, []))
    with (tmp_path / "none.jsonl").open("a") as file:
        file.write('{"kind": "none", "numb')  # power failed here
    study.append(tmp_path, _row("none", 2, []))
    study.append(tmp_path, {**_row("none", 3, []), "seed": 99})
    assert [row["number"] for row in study.rows_in(tmp_path, ("none", "one"), 1)] == [0, 2]
    order = study.Order(1, {"none": (0, 2)})
    assert list(study.run_study(order, tmp_path, 1)) == [(2, 2)]
    assert len((tmp_path / "none.jsonl").read_text().splitlines()) == 4


def test_the_whole_proof_is_one_order() -> None:
    sizes = {kind: len(numbers) for kind, numbers in study.order_of("all", None, 0).numbers.items()}
    assert sizes == {kind: found.campaigns for kind, found in KINDS.items()}
    assert sizes["outside"] + sizes["left-out"] == 120
    assert study.order_of("one", None, 0, only=7).numbers == {"one": (7,)}
    with pytest.raises(UsageError):
        study.order_of("all", None, 0, only=7)


def test_an_instrument_without_its_filter_is_refused() -> None:
    with pytest.raises(ConfigError):
        physics(_DEVICE, replace(INSTRUMENT, antialias=None))


@pytest.mark.usefixtures("brief_records")
@pytest.mark.parametrize(
    ("kind", "number", "said"),
    [
        ("none", 0, "adequate"),
        ("one", LIBRARY.index("pickoff_pole"), "right"),
        ("outside", list(OUTSIDE).index("coulomb_friction"), "unknown"),
        ("left-out", LIBRARY.index("sense_nonlinearity"), "unknown"),
    ],
)
def test_the_loop_names_what_is_hidden_and_nothing_else(kind: str, number: int, said: str) -> None:
    hidden = hide(kind, number, 2026)
    row = study.examine(hidden)
    assert answer(row, "diagnose") == said, row


@pytest.mark.usefixtures("brief_records")
def test_adding_what_is_hidden_explains_the_held_out_records() -> None:
    row = study.examine(hide("one", LIBRARY.index("cubic_stiffness"), 2026))
    assert not row["failed"]
    assert answer(row, "diagnose") == answer(row, "refine") == "right"
    assert row["refine"]["ladder"][0]["error_validate"] > 1.01
    # 1.3 % is two sd of the noise level that one second of silence gives.
    assert row["refine"]["ladder"][-1]["error_validate"] < 1.013


def test_a_law_that_is_not_in_proportion_to_its_size_is_fitted_to_its_end() -> None:
    # An inverse gap that is small beside its estimate at the null: the first columns are no longer those of the end.
    hidden = hide("one", 52, 4)
    assert hidden.effects == ("electrostatic_softening",)
    view = view_of(hidden.campaign)
    view.fit(())
    view.fit(hidden.effects)
    found = view.campaign_fit(hidden.effects)
    model = DEFAULT_COMPARE_MODEL.with_effect(*hidden.effects)
    truth = {name: hidden.values[name] for name in model.free if name in hidden.values}
    begun_there = fit_campaign(model, hidden.campaign, view.noise, truth)
    assert found.converged
    assert found.chi2 < begun_there.chi2 + 0.1
