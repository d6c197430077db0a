"""Where a model fails: a disturbance is located where it was added, and the shares of every family add up to one."""

import numpy as np
import pytest
from scipy.signal import hilbert, lfilter

from pipeline.criticism.problem import Region
from pipeline.criticism.regions import region_shares
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.excitation import Chirp, Multisine, drive_samples
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.level import NoiseLevel
from pipeline.experiment.noise.time_frequency import block_size, cell_variances, lapped
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.general.fit import CampaignFit
from pipeline.inference.general.record_fit import RecordFit
from pipeline.learning.answers import Place, to_builtins
from pipeline.learning.where.partition import campaign_partition, record_partitions
from pipeline.learning.where.regions import (
    FAMILIES,
    by_kind,
    explained,
    misfit_regions,
    remaining_shares,
    significant_places,
    structure_regions,
)

RATE, SIGMA, SILENT_DOF = 10_000.0, 1e-3, 20_000
MODEL = DEFAULT_COMPARE_MODEL
VALUES = {"f1_hz": 534.5, "f2_hz": 536.4, "f3_hz": 590.3, "zeta1": 3.2e-4, "zeta2": 1.6e-4, "zeta3": 1.2e-3}
EXCITATIONS = {
    "up": Chirp(),
    "down": Chirp((700.0, 400.0), (400.0, 700.0)),
    "low": Chirp(amplitude_v=(0.7, 0.7)),
    "multisine": Multisine(amplitude_v=(2.0, 2.0), seed=1),
}
CONDITIONS = {
    name: {
        "level": "0.35" if name == "low" else "1",
        "direction": {"down": "down", "multisine": "flat"}.get(name, "up"),
    }
    for name in EXCITATIONS
}


DRIVES = {name: drive_samples(excitation, RATE) for name, excitation in EXCITATIONS.items()}
CAMPAIGN = Campaign(
    "d", tuple(Record(n, RATE, v, np.zeros_like(v), role="fit") for n, v in DRIVES.items()), Instrument()
)


def _ringing(name: str) -> np.ndarray:
    """Each drive through a resonator at f1: it has the right times and frequencies."""
    pole = np.exp((-VALUES["zeta1"] + 1j) * 2 * np.pi * VALUES["f1_hz"] / RATE)
    gain = 2e-3 * DRIVES[name]
    return np.asarray(lfilter([1.0, -1.0], [1.0, -2 * pole.real, abs(pole) ** 2], gain, axis=0))


MOTION = {name: _ringing(name) for name in EXCITATIONS}


def _fit(missing=None, seed: int = 1, scale: float = 1.0) -> CampaignFit:
    """A fit whose residual is white noise plus ``missing(name, motion, t)`` [V]."""
    random = np.random.default_rng(seed)
    fitted = []
    for name, motion in MOTION.items():
        t = np.arange(motion.shape[0])[:, None] / RATE
        residual = scale * random.standard_normal(motion.shape)
        if missing is not None:
            residual = residual + missing(name, motion, t) / SIGMA
        residual -= residual.mean(axis=0)
        chi2, dof = float(np.sum(residual**2)), residual.size - 2
        fitted.append(
            RecordFit(name, "fit", motion, residual, chi2, dof, np.sqrt(chi2 / dof), 0.0, 0.0, None, np.zeros(2))
        )
    return CampaignFit(
        model=MODEL,
        parameters={name: (value, 0.0) for name, value in VALUES.items()},
        names=MODEL.free,
        covariance=np.zeros((len(MODEL.free),) * 2),
        x=np.zeros(len(MODEL.free)),
        x_covariance=np.zeros((len(MODEL.free),) * 2),
        records=tuple(fitted),
        noise=NoiseLevel(np.full(2, SIGMA), "silent", SILENT_DOF),
        chi2=sum(record.chi2 for record in fitted),
        dof=sum(record.dof for record in fitted) - len(MODEL.free),
        error={},
        relative_error={},
        misfit={},
        converged=True,
        fit_ok=True,
        theta_deg=None,
        split_hz=None,
    )


PARTITIONS = record_partitions(CAMPAIGN, _fit())


def _regions(fit: CampaignFit) -> list[Region]:
    return misfit_regions(fit, campaign_partition(fit, PARTITIONS), CONDITIONS)


def _rows(fit: CampaignFit) -> tuple[Place, ...]:
    return significant_places(_regions(fit), SILENT_DOF)


def _top(fit: CampaignFit) -> Place:
    return significant_places(by_kind(_regions(fit)), SILENT_DOF)[0]


@pytest.mark.parametrize("samples", [1000, 4096, 30_000])
def test_the_lapped_transform_is_orthonormal(samples):
    size = block_size(samples)
    y = np.random.default_rng(samples).standard_normal((samples, 3))
    c = lapped(y, size)
    assert np.sum(c**2) == pytest.approx(np.sum(y**2), rel=1e-12)
    variances = cell_variances(samples, size)
    assert variances.sum() * size == pytest.approx(samples, rel=1e-12)
    assert np.all(variances[:-1] == pytest.approx(1.0, abs=0.51))
    # Neighbouring cells are uncorrelated, in time and in frequency.
    inner = c[:, 1:-2]
    for a, b in ((inner[:, 1:], inner[:, :-1]), (inner[..., 1:], inner[..., :-1])):
        assert abs(np.mean(a * b)) < 5.0 / np.sqrt(a.size)


def test_every_cell_belongs_to_one_area_and_harmonics_follow_the_sweep():
    partition = PARTITIONS["up"]
    kinds = {(area.kind, area.order) for area in partition.areas}
    assert {("harmonic", k) for k in range(1, 6)} | {("resonance", 0), ("broadband", 0)} <= kinds
    assert partition.area_dof.sum() == pytest.approx(30_000, rel=1e-12)
    # Drive 1 rises from 400 to 700 Hz in 3 s: its third harmonic passes 1500 Hz at 1 s.
    third = next(k for k, area in enumerate(partition.areas) if area.order == 3)
    block, bin_ = round(1.0 * RATE / partition.size - 0.5), round(1500.0 * 2 * partition.size / RATE - 0.5)
    assert partition.area_of_cell[block, bin_] == third
    # f1 and f2 are one resonance at this resolution, f3 is another.
    assert sum(area.kind == "resonance" for area in partition.areas) == 2


@pytest.mark.parametrize(
    "missing", [None, lambda n, y, t: 0.3 * y**3, lambda n, y, t: 0.02 * np.sin(2 * np.pi * 50 * t)]
)
def test_the_shares_of_every_family_add_up_to_one(missing):
    fit = _fit(missing)
    chi2 = sum(np.sum(r.residual**2) for r in fit.records)
    regions = _regions(fit)
    for family in FAMILIES:
        own = [region for region in regions if region.family == family]
        assert sum(region.chi2 for region in own) == pytest.approx(chi2, rel=1e-9)
        assert sum(region.dof for region in own) == pytest.approx(fit.dof, rel=1e-9)
        if missing:
            assert sum(w.share for w in region_shares(own, np.inf)) == pytest.approx(1.0, abs=1e-9)
    rows = significant_places(regions, SILENT_DOF)
    remaining = remaining_shares(rows)
    for family in {row.family for row in rows}:
        assert sum(r.share for r in rows if r.family == family) + remaining[family] == pytest.approx(1.0)
    for row in rows:
        flat = [x for v in to_builtins(row).values() for x in (v if isinstance(v, list) else [v])]
        assert all(v is None or type(v) in (str, int, float) for v in flat)


def test_noise_alone_gives_no_significant_region():
    assert _rows(_fit(seed=2)) == ()
    # Nor does a noise level that is wrong by its own uncertainty.
    assert _rows(_fit(seed=2, scale=1.0 + 1.5 / np.sqrt(2 * SILENT_DOF))) == ()


@pytest.mark.parametrize("order", [2, 3])
def test_a_pickoff_nonlinearity_appears_as_a_harmonic_of_its_order(order):
    def nonlinear(name, motion, t):
        # d(x^k)/dt has no slow part; the part of the cube at the drive frequency would be absorbed by the model.
        cube = motion**3 - 0.75 * np.abs(hilbert(motion, axis=0)) ** 2 * motion
        return np.gradient(0.5 * motion**2 if order == 2 else 0.5 * cube, axis=0)

    top = _top(_fit(nonlinear))
    assert (top.kind, top.harmonic) == ("harmonic", order)
    assert top.share > 0.9


def test_lines_are_found_and_mains_harmonics_get_their_exact_frequency():
    def hum(name, motion, t):
        return 2e-3 * np.sin(2 * np.pi * 50.02 * t + 1.0) + 1e-3 * np.sin(2 * np.pi * 149.95 * t)

    fit = _fit(hum)
    assert campaign_partition(fit, PARTITIONS).lines_hz == (50.0, 150.0)
    top = _top(fit)
    assert top.kind == "line"
    assert np.mean(top.band_hz) == pytest.approx(50.0)
    # Not significant in one record, significant in the sum of four.
    found = campaign_partition(_fit(lambda n, y, t: 4e-5 * np.cos(2 * np.pi * 3217.4 * t)), PARTITIONS).lines_hz
    assert found == pytest.approx([3217.4], abs=0.1)


def test_a_ringing_resonance_is_not_a_line():
    fit = _fit(lambda n, y, t: 0.02 * y)
    assert campaign_partition(fit, PARTITIONS).lines_hz == ()
    assert _top(fit).kind == "resonance"
    assert _top(fit).band_hz[0] < 534.5 < _top(fit).band_hz[1]


def test_feedthrough_appears_at_the_drive_frequency():
    top = _top(_fit(lambda name, y, t: 2e-3 * DRIVES[name] * (name != "multisine")))
    assert (top.kind, top.harmonic) == ("harmonic", 1)


def test_a_misfit_far_above_the_drive_is_located_in_its_band():
    def high(name, motion, t):
        random = np.random.default_rng(9)
        spectrum = np.fft.rfft(random.standard_normal(motion.shape), axis=0)
        f = np.fft.rfftfreq(motion.shape[0], 1 / RATE)
        spectrum[(f < 3900.0) | (f > 4300.0)] = 0.0
        return 1e-3 * np.fft.irfft(spectrum, motion.shape[0], axis=0)

    fit = _fit(high)
    top = _top(fit)
    assert top.kind == "broadband"
    assert top.share > 0.9
    # The tests of structure find it in the same band.
    worst = min(region_shares(structure_regions(fit, PARTITIONS)), key=lambda w: w.p_value)
    assert worst.family == "band"
    assert 3900.0 <= np.mean(worst.labels["band_hz"]) <= 4300.0


def test_a_drift_appears_late_and_a_cubic_law_at_the_high_drive_level():
    rows = _rows(_fit(lambda n, y, t: 2e-3 * y * (t > 2.5)))
    late = [row for row in rows if row.family == "time"]
    assert all(row.time_s[0] >= 2.45 for row in late)
    rows = _rows(_fit(lambda n, y, t: 2e-3 * (y / np.abs(MOTION["up"]).max()) ** 2 * y))
    level = {row.level: row for row in rows if row.family == "level"}
    assert level[1.0].share > 0.99
    assert level[0.35].error == pytest.approx(1.0, abs=0.02)
    motion = [row for row in rows if row.family == "response"]
    assert motion[0].response_v[1] == pytest.approx(np.abs(MOTION["up"]).max() / np.sqrt(2.0), rel=0.3)


def test_a_misfit_in_one_channel_or_sweep_direction_is_located_there():
    rows = _rows(_fit(lambda n, y, t: 5e-3 * y * np.array([0.0, 1.0]) * (n == "down")))
    assert next(r for r in rows if r.family == "channel").channel == "sense2"
    assert next(r for r in rows if r.family == "direction").direction == "down"
    assert next(r for r in rows if r.family == "record").record == "down"


def test_structure_regions_are_chi_square_under_white_noise():
    drawn = [region for seed in range(12) for region in structure_regions(_fit(seed=100 + seed), PARTITIONS)]
    for family in ("band", "time", "resonance", "harmonic"):
        own = [r for r in drawn if r.family == family]
        z = np.array([(r.chi2 - r.dof) / np.sqrt(2.0 * r.dof) for r in own])
        assert abs(z.mean()) < 4.0 / np.sqrt(z.size)
        assert z.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * z.size))
    # Much smaller than the silent record from which the noise level was measured.
    assert max(r.dof for r in drawn) < 0.3 * SILENT_DOF


def test_the_explained_share_is_given_for_every_region():
    bad, good = _fit(lambda n, y, t: 0.02 * y), _fit(lambda n, y, t: 0.002 * y)
    partition = campaign_partition(bad, PARTITIONS)
    first, last = (misfit_regions(fit, partition, CONDITIONS) for fit in (bad, good))
    rows = significant_places(first, SILENT_DOF, last)
    assert all(row.explained == pytest.approx(0.99, abs=0.05) for row in rows if row.share > 0.1)
    assert rows[0].error_after < rows[0].error
    assert explained(first, last) == pytest.approx(0.99, abs=0.01)
