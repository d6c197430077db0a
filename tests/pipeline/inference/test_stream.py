"""Streaming identification of a growing record."""

import numpy as np
import pytest

from pipeline.device.gyro import split_hz, to_cartesian
from pipeline.errors import MeasurementError
from pipeline.identification.bandpass import bandpass
from pipeline.identification.lattice import advance, arx_of, start_lattice
from pipeline.inference.estimate import RateSettings
from pipeline.inference.gate import Gate
from pipeline.inference.screening.compressed import BandData
from pipeline.inference.screening.fit import maximise
from pipeline.inference.screening.mismatch import BROAD
from pipeline.inference.screening.stream import StreamSettings, feed, start_stream, steps
from pipeline.inference.screening.stream_estimate import estimate, noise_of

RATE = 10_000.0
QUIET = 2_000


@pytest.fixture(scope="module")
def grown(bench):
    """0.2 s of silence and the paper's chirp at 60 dB: drive, sense, truth."""
    truth = np.array([534.5, 536.4, 590.3, 3.167e-4, 1.586e-4, 11.7e-4, -33.2, 0.4, 13.33, 28.6, 0.0386, 0.0007])
    y, sigma = bench.record(truth, seed=3)
    silence = sigma[0] * np.random.default_rng(4).standard_normal((QUIET, 2))
    drive = np.concatenate([np.zeros((QUIET, 2)), bench.drive])
    return drive, np.concatenate([silence, y]), truth, sigma


def snapshots_of(bench, drive, sense, settings, block=997):
    """Every snapshot of a record fed in blocks."""
    stream, found, noise, previous = start_stream(bench.instrument, settings), [], None, None
    for first in range(0, drive.shape[0], block):
        for stream, due in steps(stream, drive[first : first + block], sense[first : first + block]):  # noqa: B020
            if due:
                noise = noise or noise_of(stream)
                seed = np.random.SeedSequence(1)
                snapshot, route = estimate(stream, noise, previous, RateSettings(0.7, 1.0, "f1"), Gate(), seed)
                previous = snapshot.x
                found.append((snapshot, route))
    return stream, found


def test_theta_and_split_converge_to_the_truth_within_their_sd(bench, grown):
    drive, sense, truth, _ = grown
    _, found = snapshots_of(bench, drive, sense, StreamSettings(first_s=0.5, every_s=0.5, line_hz=60.0))
    assert [s.estimate.status for s, _ in found] == ["ok"] * 6
    sds = np.array([s.estimate.columns["theta_deg_sd"] for s, _ in found])
    assert np.all(np.diff(sds) < 0.0)
    assert sds[-1] < 5e-4
    split = float(split_hz(to_cartesian(truth[None]))[0])
    for s, _ in found:
        assert abs(s.estimate.columns["theta_deg"] - truth[6]) < 4.0 * s.estimate.columns["theta_deg_sd"]
        assert abs(s.estimate.columns["split_hz"] - split) < 4.0 * s.estimate.columns["split_hz_sd"]


def test_the_last_snapshot_is_the_batch_fit_of_the_same_samples(bench, grown):
    drive, sense, _, _ = grown
    stream, found = snapshots_of(bench, drive, sense, StreamSettings(first_s=3.0, every_s=1.0, line_hz=60.0))
    noise, _ = noise_of(stream)
    # One sample before the drive starts belongs to the stream's data; the batch band starts with the drive.
    snapshot, route = found[-1]
    data = BandData(bench.shared.band, bench.shared.band.transform(sense[QUIET:]), bench.shared.nuisance)
    fit = maximise([data], noise.sigma_v, snapshot.x, BROAD)
    assert fit.converged
    assert np.all(np.abs(fit.x - snapshot.x) < 0.1 * np.sqrt(np.diag(fit.covariance)))
    assert abs(route.axes.mean_deg - snapshot.estimate.columns["theta_deg"]) < 0.2


def test_the_lattice_of_a_stream_is_that_of_the_bandpassed_driven_samples(bench, grown):
    drive, sense, _, _ = grown
    stream = feed(start_stream(bench.instrument, StreamSettings(order=10)), drive[:12_000], sense[:12_000])
    both = bandpass(np.concatenate([sense[:12_000], drive[:12_000]], axis=1), RATE)[QUIET - 1 :]
    ridge = 1e-12 * 20_000 * np.mean(both[:1_000] ** 2, axis=0)
    alone = advance(start_lattice(2, 2, 10, ridge), both[:, :2], both[:, 2:])
    assert stream.lattice.samples == alone.samples
    found, expected = arx_of(stream.lattice).A, arx_of(alone).A
    assert np.allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("block", [1, 500, 777, 6_000])
def test_the_state_does_not_depend_on_the_size_of_the_blocks(bench, grown, block):
    drive, sense = grown[0][:6_000], grown[1][:6_000]
    whole = feed(start_stream(bench.instrument, StreamSettings(order=10)), drive, sense)
    parts = start_stream(bench.instrument, StreamSettings(order=10, first_s=9.0))
    for first in range(0, 6_000, block):
        parts = [state for state, _ in steps(parts, drive[first : first + block], sense[first : first + block])][-1]
    assert parts.driven == whole.driven == 6_000 - QUIET + 1
    assert parts.samples == 6_000
    assert np.array_equal(np.concatenate(parts.sense_v), np.concatenate(whole.sense_v))
    assert np.array_equal(np.concatenate(parts.silent_v), np.concatenate(whole.silent_v))
    assert np.array_equal(parts.lattice.energy, whole.lattice.energy)


def test_without_silence_and_without_a_given_level_the_noise_is_refused(bench, grown):
    drive, sense, _, _ = grown
    stream = feed(start_stream(bench.instrument, StreamSettings()), drive[QUIET:], sense[QUIET:])
    with pytest.raises(MeasurementError, match="noise is unknown"):
        noise_of(stream)


def test_every_snapshot_of_data_that_the_model_does_not_explain_is_a_misfit(bench, grown):
    drive, sense, _, sigma = grown
    clipped = np.clip(sense, -1.0, 1.0)
    settings = StreamSettings(first_s=2.0, every_s=1.0, sigma_v=tuple(sigma.tolist()), line_hz=60.0)
    _, found = snapshots_of(bench, drive, clipped, settings)
    assert found
    assert all(s.estimate.status in ("misfit", "fit_failed") for s, _ in found)
