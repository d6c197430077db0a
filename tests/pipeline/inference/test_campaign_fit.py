"""General fit of campaigns: estimates agree with the truth within their covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plants import PAPER_LIKE as PLANT
from scipy.io import loadmat

from pipeline.device.model import DEFAULT_COMPARE_MODEL, SCREENING_MODEL, Model, PlantSpec
from pipeline.errors import ConfigError, MeasurementError
from pipeline.experiment.excitation import Chirp, Multisine, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.noise.level import NoiseLevel, noise_level
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.general.fit import fit_campaign
from pipeline.inference.general.scales import scaled_to

C12 = {"c12_per_s": 0.3}
PARASITIC = {
    "parasitic_mode.f": 452.0,
    "parasitic_mode.zeta": 2e-3,
    "parasitic_mode.b_d1": 0.02,
    "parasitic_mode.b_d2": -0.01,
    "parasitic_mode.a": 30.0,
}
RATE = 10_000.0
SIGMA = 1e-3
NOISE = NoiseLevel(np.full(2, SIGMA), "silent", 10_000)
EXCITATIONS = (
    ("up", Chirp(duration_s=1.0), "fit"),
    ("down", Chirp((700.0, 400.0), (400.0, 700.0), (1.0, 1.0), 1.0), "fit"),
    ("held out", Multisine(duration_s=1.0, period_s=1.0), "validate"),
)


def _campaign(model: Model, values: Mapping[str, float], sigma: float, seed: int = 0) -> Campaign:
    random = np.random.default_rng(seed)
    instrument = Instrument(antialias=AntiAlias())
    records = []
    for name, excitation, role in EXCITATIONS:
        drive = drive_samples(excitation, RATE)
        bare = Record(name, RATE, drive, np.zeros_like(drive), role)  # type: ignore[arg-type]
        y = forward(model, values, bare, instrument)
        y = y + np.array([3e-3, -5e-3]) + sigma * random.standard_normal(y.shape)
        records.append(replace(bare, sense_v=y))
    return Campaign("device", tuple(records), instrument)


def test_a_noise_free_fit_returns_the_parameters_to_1e_6() -> None:
    fit = fit_campaign(SCREENING_MODEL, _campaign(SCREENING_MODEL, PLANT | C12, 0.0), NOISE)
    assert fit.fit_ok
    for name, value in (PLANT | C12).items():
        assert fit.values[name] == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("offdiagonal_damping", C12),
        ("loop_delay", {"loop_delay.tau": 3e-6}),
        ("cubic_stiffness", {"cubic_stiffness.k3": 2e10}),
        ("adc_saturation", {"adc_saturation.1/level": 1.5}),
        ("parasitic_mode", PARASITIC),
    ],
)
def test_a_fit_with_the_right_effect_has_chi2_of_noise_and_the_truth_within_its_covariance(
    effect: str, values: dict[str, float]
) -> None:
    model = DEFAULT_COMPARE_MODEL.with_effect(effect)
    campaign = _campaign(model, PLANT | values, SIGMA)
    before = fit_campaign(DEFAULT_COMPARE_MODEL, campaign, NOISE)
    after = fit_campaign(model, campaign, NOISE, before.values)
    assert after.fit_ok
    truth = PLANT | values
    z = np.array([(after.values[name] - truth[name]) for name in after.names])
    mahalanobis = float(z @ np.linalg.solve(after.covariance, z))
    # chi2 with as many degrees of freedom as parameters: 5 sd above its mean.
    assert mahalanobis < z.size + 5.0 * np.sqrt(2.0 * z.size)
    assert abs(after.chi2 - after.dof) < 4.0 * np.sqrt(2.0 * after.dof)
    assert before.chi2 - after.chi2 > 100.0
    validate = after.of_role("validate")[0]
    assert abs(validate.chi2 - validate.dof) < 4.5 * np.sqrt(2.0 * validate.dof)
    assert after.theta_deg is not None
    assert abs(after.theta_deg[0] - PLANT["theta_deg"]) < 4.5 * after.theta_deg[1]
    assert after.split_hz is not None
    assert abs(after.split_hz[0] - 1.9) < 4.5 * after.split_hz[1]


@pytest.mark.parametrize("mains", [50.0, 60.0])
def test_hum_lines_are_found_and_their_amplitudes_fitted_and_counted_in_every_record(mains: float) -> None:
    campaign = _campaign(DEFAULT_COMPARE_MODEL, PLANT, SIGMA)
    t = np.arange(10_000) / RATE
    hum = np.stack([0.01 * np.cos(2 * np.pi * mains * t + 1.0), 0.02 * np.cos(2 * np.pi * 3 * mains * t)], axis=1)
    campaign = replace(campaign, records=tuple(replace(r, sense_v=r.sense_v + hum) for r in campaign.records))
    model = DEFAULT_COMPARE_MODEL.with_effect("mains_hum")
    fit = fit_campaign(model, campaign, NOISE, PLANT)
    assert (fit.values["mains_hum.f"], fit.values["mains_hum.top"]) == (mains, 5.0)
    # Offset, and cosine and sine of five harmonics, in each of two channels.
    assert all(r.dof == 20_000 - 2 * (1 + 2 * 5) for r in fit.records)
    assert abs(fit.chi2 - fit.dof) < 4.0 * np.sqrt(2.0 * fit.dof)


def test_a_fixed_value_and_a_tight_prior_determine_the_estimate() -> None:
    campaign = _campaign(SCREENING_MODEL, PLANT | C12, SIGMA)
    fixed = replace(SCREENING_MODEL, fixed={"c12_per_s": 0.1, "zeta3": 1.17e-3})
    fit = fit_campaign(fixed, campaign, NOISE, PLANT)
    assert fit.parameters["c12_per_s"] == (0.1, 0.0)
    assert "zeta3" not in fit.names
    tight = replace(SCREENING_MODEL, prior={"f1_hz": "normal(534.6, 1e-9)"})
    assert fit_campaign(tight, campaign, NOISE, PLANT).values["f1_hz"] == pytest.approx(534.6, abs=1e-6)


def test_a_bounded_parameter_stays_in_its_range() -> None:
    campaign = _campaign(DEFAULT_COMPARE_MODEL, PLANT, SIGMA, seed=1)
    for effect in ("pickoff_pole", "nonlinear_damping"):
        model = DEFAULT_COMPARE_MODEL.with_effect(effect)
        fit = fit_campaign(model, campaign, NOISE, PLANT)
        assert fit.fit_ok
        value, sd = next(v for k, v in fit.parameters.items() if k.startswith(effect))
        assert 0.0 <= value < 4.0 * sd


def test_the_initial_state_of_a_record_not_at_rest_is_fitted_and_counted() -> None:
    spec = Model(PlantSpec("modal", 1, "displacement"))
    values = {"f1_hz": 70.0, "zeta1": 0.02, "gain1_s1d1": 2e5}
    instrument = Instrument(sample_rate_hz=600.0, hold="foh")
    drive = np.random.default_rng(3).normal(size=(6000, 1))
    bare = Record("all", 600.0, drive, np.zeros_like(drive))
    y = forward(spec, values, bare, instrument) + 1e-3 * np.random.default_rng(4).normal(size=(6000, 1))
    records = (
        Record("fit", 600.0, drive[500:4000], y[500:4000], "fit", at_rest=False),
        Record("validate", 600.0, drive[4000:], y[4000:], "validate", at_rest=False),
    )
    noise = NoiseLevel(np.array([1e-3]), "silent", 1000)
    fit = fit_campaign(spec, Campaign("resonator", records, instrument), noise)
    assert fit.fit_ok
    for record in fit.records:
        assert record.dof == record.residual.size - 1 - 2
        assert abs(record.chi2 - record.dof) < 4.5 * np.sqrt(2.0 * record.dof)


def test_a_campaign_without_fit_records_is_refused() -> None:
    campaign = _campaign(DEFAULT_COMPARE_MODEL, PLANT, SIGMA)
    held = replace(campaign, records=tuple(replace(r, role="validate") for r in campaign.records))
    with pytest.raises(MeasurementError, match="no record to fit"):
        fit_campaign(DEFAULT_COMPARE_MODEL, held, NOISE)


_SILVERBOX = Path(__file__).resolve().parents[4] / "shared" / "data" / "silverbox" / "SNLS80mV.mat"


@pytest.mark.silverbox
@pytest.mark.skipif(not _SILVERBOX.exists(), reason="the Silverbox record is not beside the project")
def test_cubic_and_quadratic_springs_predict_the_silverbox_to_a_millivolt() -> None:
    data = loadmat(_SILVERBOX)
    u, y = (data[key].reshape(-1, 1).astype(np.float64) for key in ("V1", "V2"))
    rate = 610.35

    def record(name: str, rows: slice, role: str) -> Record:
        return Record(name, rate, u[rows].copy(), y[rows].copy(), role, at_rest=False)  # type: ignore[arg-type]

    campaign = Campaign(
        "silverbox",
        (record("train", slice(40_650, 57_000), "fit"), record("test", slice(105_712, 127_400), "validate")),
        Instrument(sample_rate_hz=rate, hold="foh", bias_v=0.0),
    )
    noise = noise_level(campaign)
    model = Model(PlantSpec("modal", 1, "displacement"))
    linear = fit_campaign(model, campaign, noise)
    model = model.with_effect("cubic_stiffness").with_effect("quadratic_stiffness")
    duffing = fit_campaign(model, campaign, noise, linear.values)
    linear_mv, duffing_mv = (
        1e3 * float(np.sqrt(np.mean((fit.of_role("validate")[0].residual * noise.sigma_v) ** 2)))
        for fit in (linear, duffing)
    )
    assert linear_mv > 5.0
    assert duffing_mv < 1.0


def test_a_displacement_is_not_integrated_twice():
    """The charge amplifier and the plant each integrate; both together would model the integral of a displacement."""
    instrument = Instrument(1000.0).with_pickoff("displacement")
    record = Record("r", 1000.0, np.ones((64, 1)), np.ones((64, 1)), role="fit")
    campaign = Campaign("d", (record,), instrument)
    for plant in ("displacement", "acceleration"):
        with pytest.raises(ConfigError, match="both state what the pick-offs sense"):
            scaled_to(Model(PlantSpec("modal", 1, plant)), campaign)
    scaled_to(Model(PlantSpec("modal", 1, "velocity")), campaign)
