"""Where a model fails: what was put into a residual is found where it was put, and the shares of a family are a whole."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import hilbert, lfilter

from pipeline.criticism.regions import where
from pipeline.experiment.excitation import Chirp, Multisine, drive_samples
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.noise.time_frequency import block_size, cell_variances, lapped
from pipeline.experiment.record import Campaign, Record
from pipeline.learning.where.plane import planes_of
from pipeline.learning.where.regions import FAMILIES, decomposed, layout_of, regions_of
from pipeline.learning.where.rows import by_kind, explained_share, where_rest, where_rows, with_after

RATE, SIGMA, SILENT_DOF = 10_000.0, 1e-3, 20_000
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


@dataclass(frozen=True)
class _Model:
    free: tuple[str, ...] = tuple(VALUES)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """As much of a record's fit as regions look at."""

    name: str
    predicted_v: np.ndarray
    residual: np.ndarray

    @property
    def dof(self) -> int:
        return self.residual.size - 2


@dataclass(frozen=True, eq=False)
class _Fit:
    records: tuple[_Fitted, ...]
    values = VALUES
    model = _Model()

    @property
    def dof(self) -> int:
        return sum(r.dof for r in self.records) - len(VALUES)

    def of_role(self, role: str) -> tuple[_Fitted, ...]:
        return self.records if role == "fit" else ()


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


def _fit(missing=None, seed: int = 1, scale: float = 1.0) -> _Fit:
    """White noise, and what ``missing(name, motion, t)`` [V] adds to it."""
    random = np.random.default_rng(seed)
    fitted = []
    for name, motion in MOTION.items():
        t = np.arange(motion.shape[0])[:, None] / RATE
        rest = scale * random.standard_normal(motion.shape)
        if missing is not None:
            rest = rest + missing(name, motion, t) / SIGMA
        fitted.append(_Fitted(name, motion, rest - rest.mean(axis=0)))
    return _Fit(tuple(fitted))


PLANES = planes_of(CAMPAIGN, _fit())


def _rows(fit: _Fit) -> list[dict]:
    return where_rows(decomposed(fit, layout_of(fit, PLANES), CONDITIONS), SILENT_DOF)


def _top(fit: _Fit) -> dict:
    return where_rows(by_kind(decomposed(fit, layout_of(fit, PLANES), CONDITIONS)), SILENT_DOF)[0]


@pytest.mark.parametrize("samples", [1000, 4096, 30_000])
def test_the_transform_keeps_energy_and_white_noise_white(samples):
    size = block_size(samples)
    y = np.random.default_rng(samples).standard_normal((samples, 3))
    c = lapped(y, size)
    assert np.sum(c**2) == pytest.approx(np.sum(y**2), rel=1e-12)
    variances = cell_variances(samples, size)
    assert variances.sum() * size == pytest.approx(samples, rel=1e-12)
    assert np.all(variances[:-1] == pytest.approx(1.0, abs=0.51))
    # Neighbouring cells do not know of each other, in time and in frequency.
    inner = c[:, 1:-2]
    for a, b in ((inner[:, 1:], inner[:, :-1]), (inner[..., 1:], inner[..., :-1])):
        assert abs(np.mean(a * b)) < 5.0 / np.sqrt(a.size)


def test_a_sweep_is_followed_and_every_cell_lies_in_one_place():
    plane = PLANES["up"]
    kinds = {(place.kind, place.order) for place in plane.places}
    assert {("harmonic", k) for k in range(1, 6)} | {("resonance", 0), ("broadband", 0)} <= kinds
    assert plane.place_dof.sum() == pytest.approx(30_000, rel=1e-12)
    # Drive 1 rises from 400 to 700 Hz in 3 s: its third harmonic passes 1500 Hz at 1 s.
    third = next(k for k, place in enumerate(plane.places) if place.order == 3)
    block, bin_ = round(1.0 * RATE / plane.size - 0.5), round(1500.0 * 2 * plane.size / RATE - 0.5)
    assert plane.cell[block, bin_] == third
    # f1 and f2 are one resonance at this resolution, f3 is another.
    assert sum(place.kind == "resonance" for place in plane.places) == 2


@pytest.mark.parametrize(
    "missing", [None, lambda n, y, t: 0.3 * y**3, lambda n, y, t: 0.02 * np.sin(2 * np.pi * 50 * t)]
)
def test_the_shares_of_every_family_are_a_whole(missing):
    fit = _fit(missing)
    chi2 = sum(np.sum(r.residual**2) for r in fit.records)
    regions = decomposed(fit, layout_of(fit, PLANES), CONDITIONS)
    for family in FAMILIES:
        own = [region for region in regions if region.family == family]
        assert sum(region.chi2 for region in own) == pytest.approx(chi2, rel=1e-9)
        assert sum(region.dof for region in own) == pytest.approx(fit.dof, rel=1e-9)
        if missing:
            assert sum(w.share for w in where(own, np.inf)) == pytest.approx(1.0, abs=1e-9)
    rows = where_rows(regions, SILENT_DOF)
    rest = where_rest(rows)
    for family in {row["family"] for row in rows}:
        assert sum(r["share"] for r in rows if r["family"] == family) + rest[family] == pytest.approx(1.0)
    for row in rows:
        flat = [x for v in row.values() for x in (v if isinstance(v, list) else [v])]
        assert all(v is None or type(v) in (str, int, float) for v in flat)


def test_noise_alone_is_nowhere():
    assert _rows(_fit(seed=2)) == []
    # A noise level that is off by its own uncertainty is nowhere too.
    assert _rows(_fit(seed=2, scale=1.0 + 1.5 / np.sqrt(2 * SILENT_DOF))) == []


@pytest.mark.parametrize("order", [2, 3])
def test_a_law_of_the_pick_off_is_a_harmonic(order):
    def bent(name, motion, t):
        # d(x^k)/dt has no slow part; what of the cube falls back on the motion itself a model would take.
        cube = motion**3 - 0.75 * np.abs(hilbert(motion, axis=0)) ** 2 * motion
        return np.gradient(0.5 * motion**2 if order == 2 else 0.5 * cube, axis=0)

    top = _top(_fit(bent))
    assert (top["kind"], top["harmonic"]) == ("harmonic", order)
    assert top["share"] > 0.9


def test_hum_is_lines_at_the_mains_and_a_strange_line_is_a_line_too():
    def hum(name, motion, t):
        return 2e-3 * np.sin(2 * np.pi * 50.02 * t + 1.0) + 1e-3 * np.sin(2 * np.pi * 149.95 * t)

    fit = _fit(hum)
    assert layout_of(fit, PLANES).lines_hz == (50.0, 150.0)
    top = _top(fit)
    assert top["kind"] == "line"
    assert np.mean(top["band_hz"]) == pytest.approx(50.0)
    # Too weak for a record alone, plain in four.
    found = layout_of(_fit(lambda n, y, t: 4e-5 * np.cos(2 * np.pi * 3217.4 * t)), PLANES).lines_hz
    assert found == pytest.approx([3217.4], abs=0.1)


def test_a_ringing_resonance_is_no_line():
    fit = _fit(lambda n, y, t: 0.02 * y)
    assert layout_of(fit, PLANES).lines_hz == ()
    assert _top(fit)["kind"] == "resonance"
    assert _top(fit)["band_hz"][0] < 534.5 < _top(fit)["band_hz"][1]


def test_feedthrough_follows_the_drive_itself():
    top = _top(_fit(lambda name, y, t: 2e-3 * DRIVES[name] * (name != "multisine")))
    assert (top["kind"], top["harmonic"]) == ("harmonic", 1)


def test_what_lies_far_above_the_drive_is_seen():
    def high(name, motion, t):
        random = np.random.default_rng(9)
        spectrum = np.fft.rfft(random.standard_normal(motion.shape), axis=0)
        f = np.fft.rfftfreq(motion.shape[0], 1 / RATE)
        spectrum[(f < 3900.0) | (f > 4300.0)] = 0.0
        return 1e-3 * np.fft.irfft(spectrum, motion.shape[0], axis=0)

    fit = _fit(high)
    top = _top(fit)
    assert top["kind"] == "broadband"
    assert top["share"] > 0.9
    # The loop's own test sees it, in the band where it is.
    worst = min(where(regions_of(fit, PLANES)), key=lambda w: w.p_value)
    assert worst.family == "band"
    assert 3900.0 <= np.mean(worst.labels["band_hz"]) <= 4300.0


def test_drift_is_late_and_hardening_is_at_the_high_level_only():
    rows = _rows(_fit(lambda n, y, t: 2e-3 * y * (t > 2.5)))
    late = [row for row in rows if row["family"] == "time"]
    assert all(row["time_s"][0] >= 2.45 for row in late)
    rows = _rows(_fit(lambda n, y, t: 2e-3 * (y / np.abs(MOTION["up"]).max()) ** 2 * y))
    level = {row["level"]: row for row in rows if row["family"] == "level"}
    assert level[1.0]["share"] > 0.99
    assert level[0.35]["error"] == pytest.approx(1.0, abs=0.02)
    motion = [row for row in rows if row["family"] == "response"]
    assert motion[0]["response_v"][1] == pytest.approx(np.abs(MOTION["up"]).max() / np.sqrt(2.0), rel=0.3)


def test_one_channel_and_one_direction_are_told():
    rows = _rows(_fit(lambda n, y, t: 5e-3 * y * np.array([0.0, 1.0]) * (n == "down")))
    assert next(r for r in rows if r["family"] == "channel")["channel"] == "sense2"
    assert next(r for r in rows if r["family"] == "direction")["direction"] == "down"
    assert next(r for r in rows if r["family"] == "record")["record"] == "down"


def test_regions_for_the_loop_are_chi_square_under_white_noise():
    drawn = [region for seed in range(12) for region in regions_of(_fit(seed=100 + seed), PLANES)]
    for family in ("band", "time", "resonance", "harmonic"):
        own = [r for r in drawn if r.family == family]
        z = np.array([(r.chi2 - r.dof) / np.sqrt(2.0 * r.dof) for r in own])
        assert abs(z.mean()) < 4.0 / np.sqrt(z.size)
        assert z.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * z.size))
    # Small beside the silence that the noise level comes from.
    assert max(r.dof for r in drawn) < 0.3 * SILENT_DOF


def test_what_a_better_model_explains_is_told_region_by_region():
    bad, good = _fit(lambda n, y, t: 0.02 * y), _fit(lambda n, y, t: 0.002 * y)
    layout = layout_of(bad, PLANES)
    first, last = (decomposed(fit, layout, CONDITIONS) for fit in (bad, good))
    rows = with_after(where_rows(first, SILENT_DOF), first, last)
    assert all(row["explained"] == pytest.approx(0.99, abs=0.05) for row in rows if row["share"] > 0.1)
    assert rows[0]["error_after"] < rows[0]["error"]
    assert explained_share(first, last) == pytest.approx(0.99, abs=0.01)
