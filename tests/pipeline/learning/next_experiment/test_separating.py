"""The separating record: its predicted SNR is that of refits, and it separates the class once it is measured."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from pipeline.criticism.budget import DETECTABLE_SNR
from pipeline.criticism.verdict import TermClass
from pipeline.experiment.campaign import write_campaign
from pipeline.experiment.files.readers import read_columns, write_columns
from pipeline.experiment.forward.record import forward
from pipeline.experiment.noise.measure import Hum, measured
from pipeline.inference.general.fit import fit_campaign
from pipeline.learning.campaign.answers import campaign_answers, separating_text
from pipeline.learning.next_experiment.experiments import Experiment, experiments
from pipeline.learning.next_experiment.separating import separating_record
from workflows.cli import call
from workflows.simulate import campaign_config, simulate


def one_chirp(effect):
    """A simulated device with one effect, and its campaign reduced to one chirp, one validation record and silence."""
    made = simulate(campaign_config(None), {}, [effect], 3)
    kept = tuple(r for r in made.campaign.records if r.name in ("silence", "chirp", "validate-swapped"))
    return made, replace(made.campaign, records=kept)


def response(made, record):
    instrument, gain = made.campaign.instrument, made.campaign.angular_gain
    return forward(made.model, made.parameters, record, instrument, angular_gain=gain)


@pytest.fixture(scope="module")
def drifting():
    """A gain drift in one chirp without noise, its fits as gain drift and as mismatch, and their separating record."""
    made, campaign = one_chirp("gain_drift:gamma=0.00045")
    quiet = tuple(r if r.role == "noise" else replace(r, sense_v=response(made, r)) for r in campaign.records)
    campaign = replace(campaign, records=quiet)
    problem = campaign_answers(campaign).problem
    fits = {}
    for name in ("gain_drift", "electrode_mismatch"):
        fits[name] = problem.fit((name,))
    found = TermClass("gain_drift", ("gain_drift", "electrode_mismatch"), ())
    return made, problem, fits, separating_record(problem, ("gain_drift",), found)


def test_the_predicted_snr_is_that_of_refits_on_old_and_new_records(drifting):
    _, problem, fits, proposal = drifting
    campaign = problem.campaign
    record = proposal.experiment.record(campaign)
    assert np.array_equal(record.drive_v, proposal.drive_v)
    rises = []
    for right, wrong in (proposal.members, proposal.members[::-1]):
        true, other = problem.campaign_fit((right,)), problem.campaign_fit((wrong,))
        predicted = forward(true.model, true.values, record, campaign.instrument, angular_gain=campaign.angular_gain)
        whole = replace(campaign, records=(*campaign.records, replace(record, sense_v=predicted)))
        # The new record is the prediction of the right fit, so its refit is its fit.
        refit = fit_campaign(other.model, whole, problem.noise, other.values)
        rises.append(refit.chi2 - fits[right].chi2)
    # The smaller SNR of the two ways round is predicted; the new rows are linearized at the fit of the old ones.
    assert proposal.snr > DETECTABLE_SNR
    assert proposal.snr == pytest.approx(np.sqrt(min(rises)), rel=0.05)


def test_the_old_records_alone_do_not_separate_the_class(drifting):
    _, _, fits, proposal = drifting
    assert fits["electrode_mismatch"].chi2 - fits["gain_drift"].chi2 < (proposal.snr / 2.0) ** 2


def test_experiments_exceed_neither_the_highest_drive_level_nor_the_range_of_the_converter(drifting):
    made, problem, _, proposal = drifting
    campaign = problem.campaign
    highest_drive_v = max(float(np.max(np.abs(r.drive_v))) for r in campaign.records)
    assert proposal.sample_rate_hz == campaign.instrument.sample_rate_hz
    assert np.max(np.abs(response(made, proposal.experiment.record(campaign)))) < campaign.instrument.adc.full_scale_v
    fitted = problem.campaign_fit(("gain_drift",))
    offered = experiments(campaign, fitted.model, fitted.values, ("gain_drift", "electrode_mismatch"))
    assert max(np.max(np.abs(one.record(campaign).drive_v)) for one in offered) <= highest_drive_v * (1.0 + 1e-12)
    assert all(one.bias_v is None and one.rate_dps is None for one in offered)


def test_bias_and_rate_are_varied_if_a_member_depends_on_them(drifting):
    _, problem, _, _ = drifting
    fitted = problem.campaign_fit(("gain_drift",))

    def offered(*terms: str) -> tuple[Experiment, ...]:
        return experiments(problem.campaign, fitted.model, fitted.values, terms)

    assert any(one.bias_v is not None for one in offered("cubic_stiffness", "electrostatic_softening"))
    assert {one.rate_dps for one in offered("offdiagonal_damping", "angular_rate")} == {None, 0.0, 100.0}


def test_a_device_with_one_drive_is_offered_one_drive(drifting):
    _, problem, _, _ = drifting
    single = tuple(replace(r, drive_v=r.drive_v[:, :1], sense_v=r.sense_v[:, :1]) for r in problem.campaign.records)
    offered = experiments(replace(problem.campaign, records=single), problem.model, {"f1_hz": 535.0}, ("gain_drift",))
    assert {one.record(problem.campaign).drive_v.shape[1] for one in offered} == {1}
    assert not any("drive" in one.shape for one in offered)


def test_no_record_of_this_instrument_separates_a_delay_from_a_pole(tmp_path):
    _, campaign = one_chirp("loop_delay:tau=1e-6")
    problem = campaign_answers(campaign).problem
    problem.fit(("pickoff_pole",), problem.fit(("loop_delay",)))
    proposal = separating_record(problem, ("loop_delay",), TermClass("loop_delay", ("loop_delay", "pickoff_pole"), ()))
    assert proposal.snr < 0.1
    assert proposal.text().startswith("none with this instrument (best: ")
    assert proposal.write(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_without_a_class_there_is_no_separating_record():
    assert separating_text((), written=True) is None


def test_the_measured_separating_record_resolves_the_class(tmp_path, capfd):
    made, campaign = one_chirp("gain_drift:gamma=0.0003")
    folder = tmp_path / "campaign"
    write_campaign(campaign, folder)
    assert call(["diagnose", str(folder), "--out", str(tmp_path / "out"), "--json"]) == 0
    first = json.loads(capfd.readouterr().out)
    assert (first["verdict"], [set(c) for c in first["classes"]]) == ("class", [{"gain_drift", "electrode_mismatch"}])
    file, _, rest = first["separating_record"].partition(": ")
    assert "predicted SNR" in rest
    assert not first["separating_record"].startswith("none")
    # The record is measured on the device and added to the campaign with the lines that were written for it.
    columns = read_columns(tmp_path / "out" / file)
    stanza = (tmp_path / "out" / file).with_suffix(".toml").read_text()
    declared = tomllib.loads(stanza)["record"][0]
    assert declared["file"] == file
    drive = np.stack([columns["drive1_V"], columns["drive2_V"]], axis=1)
    rate = 1.0 / (columns["time_s"][1] - columns["time_s"][0])
    record = replace(campaign.records[1], drive_v=drive, sense_v=np.zeros_like(drive))
    volts = measured(response(made, record), rate, 1e-3, Hum(), campaign.instrument.adc, np.random.default_rng(7))
    columns |= {f"sense{k + 1}_V": np.ascontiguousarray(v) for k, v in enumerate(volts.T)}
    write_columns(folder, file.removesuffix(".parquet"), columns, "parquet")
    with (folder / "campaign.toml").open("a") as table:
        table.write("\n" + stanza)
    assert call(["diagnose", str(folder), "--json"]) == 0
    again = json.loads(capfd.readouterr().out)
    assert (again["verdict"], again["effects"]) == ("effect", ["gain_drift"])
    assert again["separating_record"] is None
