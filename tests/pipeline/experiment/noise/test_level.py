"""The measured noise level equals the simulated one, whatever else the records contain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plants import PAPER_LIKE as PLANT

from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.errors import MeasurementError
from pipeline.experiment.excitation import Chirp, Multisine, Silence, drive_samples
from pipeline.experiment.forward.record import forward
from pipeline.experiment.instrument import Adc, AntiAlias, Instrument
from pipeline.experiment.noise.level import noise_level
from pipeline.experiment.noise.measure import Hum, measured
from pipeline.experiment.record import Campaign, Record

RATE = 10_000.0


def _campaign(
    sigma: float, hum: Hum, adc: Adc | None, *excitations: tuple[Chirp | Multisine | Silence, str]
) -> Campaign:
    random = np.random.default_rng(5)
    instrument = Instrument(antialias=AntiAlias(), adc=adc)
    records = []
    for i, (excitation, role) in enumerate(excitations):
        drive = drive_samples(excitation, RATE)
        bare = Record(f"record-{i}", RATE, drive, np.zeros_like(drive), role)  # type: ignore[arg-type]
        y = 0.01 + forward(DEFAULT_COMPARE_MODEL, PLANT, bare, instrument)
        records.append(replace(bare, sense_v=measured(y, RATE, sigma, hum, adc, random)))
    return Campaign("device", tuple(records), instrument)


HUM = Hum(50.013, (5e-3, 0.0, 2e-3, 0.0, 1e-3))


@pytest.mark.parametrize("hum", [Hum(), HUM])
def test_a_silent_record_gives_sigma_with_and_without_hum(hum: Hum) -> None:
    level = noise_level(_campaign(1e-3, hum, None, (Silence(), "noise"), (Chirp(duration_s=0.5), "fit")))
    assert level.source == "silent"
    assert np.all(np.abs(level.sigma_v / 1e-3 - 1.0) < 4.0 / np.sqrt(2.0 * level.dof) + 0.003)


def test_quantisation_noise_is_added_where_silence_does_not_exercise_the_adc() -> None:
    adc = Adc(bits=12, full_scale_v=10.0)
    level = noise_level(_campaign(0.1 * adc.lsb_v, Hum(), adc, (Silence(), "noise"), (Chirp(duration_s=0.5), "fit")))
    assert np.all(level.sigma_v >= adc.lsb_v / np.sqrt(12.0))
    assert np.all(level.sigma_v < 1.1 * adc.lsb_v / np.sqrt(12.0))


def test_repeats_give_sigma_where_no_record_is_silent() -> None:
    chirp = Chirp(duration_s=1.0)
    level = noise_level(_campaign(1e-3, HUM, None, (chirp, "fit"), (chirp, "fit")))
    assert level.source == "repeats"
    assert np.all(np.abs(level.sigma_v / 1e-3 - 1.0) < 4.0 / np.sqrt(2.0 * level.dof) + 0.003)


def test_a_local_fit_gives_sigma_without_silence_and_repeats() -> None:
    level = noise_level(_campaign(1e-3, Hum(), None, (Chirp(), "fit"), (Multisine(), "validate")))
    assert level.source == "local"
    # Quiet windows scatter by 1 / sqrt(2 dof); the few near the modes raise the median by less than 0.5 %.
    assert np.all(np.abs(level.sigma_v / 1e-3 - 1.0) < 4.0 / np.sqrt(2.0 * level.dof) + 0.005)


def test_a_disturbance_at_all_frequencies_of_one_record_does_not_enter_a_local_fit_and_of_both_is_only_a_bound() -> (
    None
):
    quiet = _campaign(1e-3, Hum(), None, (Chirp(), "fit"), (Chirp((700.0, 400.0), (400.0, 700.0)), "fit"))

    def clipped(record: Record) -> Record:
        return replace(record, sense_v=np.clip(record.sense_v, -0.5 * record.sense_v.max(), np.inf))

    one = noise_level(replace(quiet, records=(quiet.records[0], clipped(quiet.records[1]))))
    both = noise_level(replace(quiet, records=tuple(clipped(record) for record in quiet.records)))
    assert one.source == "local"
    assert np.all(np.abs(one.sigma_v / 1e-3 - 1.0) < 4.0 / np.sqrt(2.0 * one.dof) + 0.005)
    assert both.source == "residual"
    assert not both.known
    assert np.all(both.sigma_v > 1.5e-3)


def test_a_channel_without_noise_is_refused() -> None:
    campaign = _campaign(0.0, Hum(), None, (Silence(), "noise"), (Chirp(duration_s=0.5), "fit"))
    silent = replace(campaign.records[0], sense_v=np.zeros_like(campaign.records[0].sense_v))
    with pytest.raises(MeasurementError, match="no noise"):
        noise_level(replace(campaign, records=(silent, campaign.records[1])))


@pytest.mark.parametrize(("louder", "pooled"), [(1.0, True), (1.1, False)])
def test_repeats_are_pooled_with_silence_only_where_both_agree(louder: float, pooled: bool) -> None:
    chirp = (Chirp(duration_s=0.5), "fit")
    campaign = _campaign(1e-3, Hum(), None, (Silence(), "noise"), chirp, chirp)
    extra = np.sqrt(louder**2 - 1.0) * 1e-3 * np.random.default_rng(6).standard_normal((5000, 2))
    records = [r if r.role == "noise" else replace(r, sense_v=r.sense_v + extra) for r in campaign.records[:2]]
    level = noise_level(replace(campaign, records=(*records, campaign.records[2])))
    alone = noise_level(replace(campaign, records=(records[0],)))
    assert level.source == alone.source == "silent"
    assert (level.dof > alone.dof) == pooled
    assert pooled or np.array_equal(level.sigma_v, alone.sigma_v)
