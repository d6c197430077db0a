"""The learning loop on campaigns with one drive and one sense: with a silent record, with repeats, with neither."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import resample_poly

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model, PlantSpec
from pipeline.errors import ConfigError, MeasurementError
from pipeline.experiment.excitation import Chirp, Multisine, Silence, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Campaign, Record
from workflows import learning

RATE = 10_000.0
SIGMA_V = 1e-3
INSTRUMENT = Instrument(sample_rate_hz=RATE, antialias=AntiAlias())
TWO_MODES = PlantSpec("modal", 2, "velocity")
MODES = {
    "f1_hz": 534.0,
    "zeta1": 3e-4,
    "gain1_s1d1": 12.0,
    "f2_hz": 590.0,
    "zeta2": 1e-3,
    "gain2_s1d1": 20.0,
}
FIT = (
    Chirp((400.0,), (700.0,), (2.0,)),
    Chirp((700.0,), (400.0,), (2.0,)),
    Chirp((400.0,), (700.0,), (0.7,)),
)
HELD = (Chirp((700.0,), (400.0,), (1.2,)), Multisine(amplitude_v=(2.0,), seed=3))


def campaign(model, values, silent=False, repeat=False, seed=1):
    excitations = [("fit", e) for e in FIT] + [("fit", FIT[0])] * repeat + [("validate", e) for e in HELD]
    excitations = [(role, replace(e, duration_s=1.5)) for role, e in excitations]
    excitations += [("noise", Silence(1, 1.0))] * silent
    random = np.random.default_rng(seed)
    records = []
    for k, (role, excitation) in enumerate(excitations):
        drive = drive_samples(excitation, RATE)
        record = Record(f"{role} {k}", RATE, drive, np.zeros_like(drive), role)
        volts = forward(model, values, record, INSTRUMENT)
        records.append(replace(record, sense_v=volts + SIGMA_V * random.standard_normal(volts.shape)))
    return Campaign("one drive", tuple(records), INSTRUMENT)


@pytest.mark.parametrize(
    ("noise", "source"), [({"silent": True}, "silent"), ({"repeat": True}, "repeats"), ({}, "residual")]
)
def test_two_hidden_effects_are_found_with_every_source_of_the_noise_level(noise, source):
    hidden = {"cubic_stiffness.k3": 5e8, "nonlinear_damping.d": 0.5}
    made = campaign(Model(TWO_MODES, ("cubic_stiffness", "nonlinear_damping")), {**MODES, **hidden}, **noise)
    found = learning.refine(made, Model(TWO_MODES))
    answer = found.answer
    assert set(found.effects) == {"cubic_stiffness", "nonlinear_damping"}
    assert found.verdict == "adequate"
    assert {rung.status for rung in answer.ladder[1:]} == {"confirmed"}
    assert answer.noise.from_ == source
    assert answer.noise.sigma[0] == pytest.approx(SIGMA_V, rel=0.05)
    for name, truth in hidden.items():
        value, sd = answer.parameters[name]
        assert abs(value - truth) < 4.0 * sd
    last = answer.ladder[-1]
    assert (last.error_validate is None) == (source == "residual")
    assert all(volts == pytest.approx(SIGMA_V, rel=0.03) for volts in last.error_v.values())


def test_a_real_feedthrough_gives_no_hint_about_the_hold():
    one = PlantSpec("modal", 1, "velocity")
    values = {name: value for name, value in MODES.items() if "1_" in name or name == "zeta1"}
    made = campaign(
        Model(one, ("capacitive_feedthrough",)), {**values, "capacitive_feedthrough.C_s1d1": 3e-6}, silent=False
    )
    found = learning.refine(made, Model(one))
    assert found.effects == ("capacitive_feedthrough",)
    assert found.answer.hints == ()


def test_no_effect_is_named_where_none_is_hidden_and_the_noise_level_is_unknown():
    found = learning.diagnose(campaign(Model(TWO_MODES), MODES), Model(TWO_MODES))
    assert (found.verdict, found.effects) == ("adequate", ())


def test_plant_gyro_refuses_a_campaign_with_one_drive():
    with pytest.raises(ConfigError, match="modal"):
        learning.refine(campaign(Model(TWO_MODES), MODES), DEFAULT_COMPARE_MODEL)


def test_records_too_short_for_a_noise_estimate_are_refused():
    made = campaign(Model(TWO_MODES), MODES)
    short = tuple(replace(r, drive_v=r.drive_v[:60], sense_v=r.sense_v[:60]) for r in made.records)
    with pytest.raises(MeasurementError, match="silent"):
        learning.compare(replace(made, records=short), Model(TWO_MODES))


@pytest.mark.parametrize("extra", [{}, {"pickoff_pole.T": 1e-4}])
def test_a_bandlimited_hold_equals_resampling_the_drive_eight_times(extra):
    rate = 610.0
    model = Model(PlantSpec("modal", 1, "displacement"), ("cubic_stiffness", *(n.split(".")[0] for n in extra)))
    values = {"f1_hz": 68.0, "zeta1": 0.05, "gain1_s1d1": 1.9e5, "cubic_stiffness.k3": 7e5, **extra}
    drive = 0.02 * np.random.default_rng(1).standard_normal((4000, 1))
    fine = resample_poly(drive, 8, 1, axis=0)
    slow = Record("slow", rate, drive, np.zeros_like(drive))
    fast = Record("fast", 8.0 * rate, fine, np.zeros_like(fine))
    y = forward(model, values, slow, Instrument(sample_rate_hz=rate, hold="bandlimited"))
    expected = forward(model, values, fast, Instrument(sample_rate_hz=8.0 * rate, hold="foh"))[::8]
    assert np.linalg.norm(y - expected) < 2e-6 * np.linalg.norm(expected)
