"""Bad samples are found where they were planted, and nowhere in sound records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.errors import MeasurementError
from pipeline.experiment import outliers
from pipeline.experiment.bad_samples import bad_stretches, refilled, without_bad_samples
from pipeline.experiment.instrument import Adc, Instrument
from pipeline.experiment.record import Campaign, Record
from tests.pipeline.experiment.checks.planted_faults import FS, chirps, sensed

ADC = Adc()
SIGMA_V = 1e-3
DRIVE = chirps(20_000)
MOTION = sensed(DRIVE)
RNG = np.random.default_rng(20)


def converted(volts):
    return np.rint(volts / ADC.lsb_v) * ADC.lsb_v


def record_of(sense_v, drive_v=DRIVE):
    return Record("chirp", FS, drive_v, sense_v, role="fit")


def flags(record):
    out = np.zeros(record.sense_v.shape, dtype=bool)
    for one in bad_stretches(record, ADC):
        out[one.first : one.stop, one.channel] = True
    return out


def pink(random, shape):
    amplitude = 1.0 / np.sqrt(np.maximum(np.fft.rfftfreq(shape[0]), 1.0 / shape[0]))
    y = np.fft.irfft(amplitude[:, None] * np.fft.rfft(random.standard_normal(shape), axis=0), shape[0], axis=0)
    return y / y.std()


NOISES = {
    "white": lambda random, shape: random.standard_normal(shape),
    "AR": lambda random, shape: np.sqrt(0.51) * lfilter([1.0], [1.0, -0.7], random.standard_normal(shape), axis=0),
    "1/f": pink,
    "t4": lambda random, shape: random.standard_t(4.0, shape) / np.sqrt(2.0),
    "laplace": lambda random, shape: random.laplace(size=shape) / np.sqrt(2.0),
}


@pytest.mark.parametrize("noise", NOISES)
def test_sound_records_have_no_bad_samples_whatever_the_noise(noise):
    random = np.random.default_rng(len(noise))
    for _ in range(3):
        volts = MOTION + SIGMA_V * NOISES[noise](random, MOTION.shape)
        assert bad_stretches(record_of(converted(volts)), ADC) == ()
        silence = SIGMA_V * NOISES[noise](random, MOTION.shape)
        assert bad_stretches(record_of(converted(silence), 0.0 * DRIVE), ADC) == ()


def test_jitter_of_the_clock_and_a_record_without_noise_are_no_bad_samples():
    jitter = 0.3e-6 * FS * RNG.standard_normal(MOTION.shape) * np.gradient(MOTION, axis=0)
    assert bad_stretches(record_of(converted(MOTION + jitter + 1e-4 * RNG.standard_normal(MOTION.shape))), ADC) == ()
    assert bad_stretches(record_of(MOTION), None) == ()


@pytest.mark.parametrize("sigma_lsb", [0.0, 0.2, 0.39, 0.7, 3.0])
def test_quantised_silence_and_a_decay_below_one_lsb_are_not_stuck(sigma_lsb):
    t = np.arange(20_000) / FS
    noise = sigma_lsb * ADC.lsb_v * RNG.standard_normal((t.size, 2))
    decay = np.stack([0.05 * np.exp(-a * t) * np.cos(2 * np.pi * 535.0 * t) for a in (3.0, 30.0)], axis=1)
    for volts in (noise, decay + noise, 100.0 * ADC.lsb_v * np.sin(2 * np.pi * 50.0 * t)[:, None] + noise):
        assert bad_stretches(Record("silence", FS, 0.0 * DRIVE, converted(volts), at_rest=False), ADC) == ()


@pytest.mark.parametrize("depth", [0.99, 0.97, 0.9, 0.7, 0.4])
@pytest.mark.parametrize("clips_noise", [False, True])
def test_clipping_below_full_scale_is_not_marked(depth, clips_noise):
    level = depth * np.max(np.abs(MOTION))
    noise = SIGMA_V * np.random.default_rng(3).standard_normal(MOTION.shape)
    volts = np.clip(MOTION + noise, -level, level) if clips_noise else np.clip(MOTION, -level, level) + noise
    # A sample at the foot of a clipped top may be taken for a spike: at most one in ten clipped records, one sample each.
    assert np.count_nonzero(flags(record_of(converted(volts)))) <= 1


@pytest.mark.parametrize("noise", ["white", "AR", "1/f"])
def test_spikes_of_ten_sigma_and_stuck_samples_are_found(noise):
    random = np.random.default_rng(7)
    volts = MOTION + SIGMA_V * NOISES[noise](random, MOTION.shape)
    truth = np.zeros(MOTION.shape, dtype=bool)
    for channel in range(2):
        at = random.choice(MOTION.shape[0], 20, replace=False)
        volts[at, channel] += np.repeat([10.0 * SIGMA_V, 0.3], 10) * random.choice([-1.0, 1.0], 20)
        first = int(random.integers(2000, 15_000))
        volts[first : first + 31, channel] = volts[first, channel]
        truth[at, channel] = truth[first + 1 : first + 31, channel] = True
    found = flags(record_of(converted(volts)))
    assert not np.any(truth & ~found)
    assert np.count_nonzero(found & ~truth) <= 8


def test_reasons_are_named():
    volts = MOTION + SIGMA_V * RNG.standard_normal(MOTION.shape)
    volts[5000, 0] += 0.3
    volts[9000:9030, 1] = volts[9000, 1]
    volts[12_000:12_020, 0] = 0.0
    volts[15_000:15_003, 1] = 20.0
    sense = np.clip(converted(volts), -ADC.full_scale_v, ADC.full_scale_v - ADC.lsb_v)
    found = {(one.reason, one.channel): one for one in bad_stretches(record_of(sense), ADC)}
    assert set(found) == {("spike", 0), ("stuck", 1), ("dropout", 0), ("full_scale", 1)}
    assert (found["spike", 0].first, found["spike", 0].stop) == (5000, 5001)
    assert (found["full_scale", 1].first, found["full_scale", 1].stop) == (15_000, 15_003)
    assert abs(found["dropout", 0].first - 12_000) <= 1
    assert abs(found["dropout", 0].stop - 12_020) <= 1


def test_interpolated_samples_lie_within_the_noise_of_the_motion_and_good_samples_stay():
    volts = converted(MOTION + SIGMA_V * RNG.standard_normal(MOTION.shape))
    spoilt = volts.copy()
    spoilt[8000, 0] -= 0.5
    spoilt[9000:9030, 1] = spoilt[9000, 1]
    (marked,) = without_bad_samples(Campaign("A", (record_of(spoilt),), Instrument(adc=ADC))).records
    good = marked.good
    assert np.array_equal(marked.sense_v[good], spoilt[good])
    assert np.max(np.abs(marked.sense_v - MOTION)[~good]) < 5.0 * SIGMA_V
    filled = refilled(marked, MOTION)
    assert np.max(np.abs(filled.sense_v - MOTION)[~good]) < 2.0 * SIGMA_V
    assert without_bad_samples(Campaign("A", (marked,), Instrument(adc=ADC))).records[0] is marked


def test_a_record_with_more_than_two_percent_bad_samples_is_refused_by_name():
    volts = MOTION + SIGMA_V * RNG.standard_normal(MOTION.shape)
    volts[4000:4500, 1] = volts[4000, 1]
    campaign = Campaign("A", (replace(record_of(converted(volts)), name="run-7"),), Instrument(adc=ADC))
    with pytest.raises(MeasurementError, match=r"run-7: too many bad samples \(stuck\).*2\.5 %.*at most 2 %"):
        without_bad_samples(campaign)


def test_a_long_record_is_searched_in_parts_with_the_same_result(monkeypatch):
    sense_v = MOTION + SIGMA_V * RNG.standard_normal(MOTION.shape)
    spikes = np.array([5_000, 9_990, 12_345])
    sense_v[spikes, 0] += 0.05
    sense_v[7_000:13_000, 1] = sense_v[7_000, 1]
    whole = flags(record_of(converted(sense_v)))
    monkeypatch.setattr(outliers, "_PART", 5_000)
    assert len(outliers.parts(len(sense_v))) == 4
    found = flags(record_of(converted(sense_v)))
    assert found[spikes, 0].all()
    assert found[7_001:13_000, 1].all()
    assert np.count_nonzero(found != whole) <= 1
