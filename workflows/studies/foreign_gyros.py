"""Study of gyros that are not the paper's: does ``identify`` find theta and split of any gyro from any chirp?

    H(s) = sum_k a_k b_k^T s / (s^2 + w_k s / Q_k + w_k^2)      two rocking modes and an up-down mode, from v to S

Each mode is a complex recursion, exact for the hold of the drive samples; no code is shared with the model under test.  Drawn
are frequencies, Q, split, theta, gains, imbalances, sample rate, hold, band and duration of the chirp.  Both drives sweep at
once, in opposite directions, or one after the other; the pick-offs sense velocity or displacement.  White noise at 60 dB; two
records are fitted, one of silence measures the noise.

    DIR/<kind>.jsonl    one JSON object per device; an interrupted study continues there

A row depends on (seed, kind, number) only.  Shapes: N samples of a record, (N, 2) [V].
"""

from __future__ import annotations

import cmath
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.errors import GyroscreenError
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.layout import layout_of
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.identify import identify

from .coverage import Share, offsets
from .rows_by_kind import add_rows, processor_times

KINDS: dict[str, str] = {
    "both": "both drives sweep at once, in opposite directions; swapped in the second record",
    "alternate": "each record drives one electrode, and the other is at zero",
    "displacement": "as both, with pick-offs that sense displacement",
    "pairs": "as both, with a differential pair of electrodes on each axis, which neither sense nor drive the up-down mode",
    "four": "as both, with four electrodes at +-x and +-y that sense, and four that drive; two of them are driven",
}


@dataclass(frozen=True, eq=False)
class ElectrodeRows:
    """What sense columns measure, and drive columns act on: rows (x, y, z) of each column."""

    senses: FloatArray
    drives: FloatArray

    def gains(self, imbalance: float) -> FloatArray:
        """Relative gain (n,) of n columns: 1 - k for the first of two axes, 1 + k for the second."""
        count = len(self.senses)
        return np.where(np.arange(count) < count // 2, 1.0 - imbalance, 1.0 + imbalance)


_PAPER = ElectrodeRows(np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]]), np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]))
_CROSS = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
#: ElectrodeRows of the kinds that are not laid out as the paper's.
LAYOUTS: dict[str, ElectrodeRows] = {
    "pairs": ElectrodeRows(np.eye(2, 3), np.eye(2, 3)),
    "four": ElectrodeRows(_CROSS, _CROSS),
}
#: Noise of 60 dB: a thousandth of the rms of the signal.
_NOISE = 1e-3
#: Longest record [samples], so that a study of 200 devices takes minutes; the highest Q needs 2e5 for two ring-down times.
_MOST_SAMPLES = 400_000
_FREQUENCY_HZ, _QUALITY, _SPLIT_HZ = (200.0, 50_000.0), (50.0, 100_000.0), (0.1, 500.0)
_STREAM = 120


@dataclass(frozen=True)
class ForeignGyro:
    """A gyro and its experiment.

    frequency_hz, quality : rocking 1, rocking 2, up-down; theta_deg; gains : rocking, up-down [1/s]; imbalances : sense, drive.
    rate_hz, hold, low_hz, high_hz, duration_s : of the experiment.
    """

    frequency_hz: tuple[float, float, float]
    quality: tuple[float, float, float]
    theta_deg: float
    gains: tuple[float, float]
    imbalances: tuple[float, float]
    rate_hz: float
    hold: Literal["zoh", "foh"]
    low_hz: float
    high_hz: float
    duration_s: float

    @property
    def split_hz(self) -> float:
        return self.frequency_hz[1] - self.frequency_hz[0]


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.uniform())


def draw_gyro(random: np.random.Generator) -> ForeignGyro:
    """A gyro with a split of at least 0.02 line widths, and a chirp of at least 2 ring-down times over its modes."""
    f, q = _log_uniform(random, *_FREQUENCY_HZ), _log_uniform(random, *_QUALITY)
    width, ring_down = f / q, q / (math.pi * f)
    least, most = max(_SPLIT_HZ[0], 0.02 * width), min(_SPLIT_HZ[1], 0.05 * f)
    split = _log_uniform(random, least, max(most, 1.01 * least))
    f3 = f * (1.0 + float(random.choice([-1.0, 1.0])) * random.uniform(0.06, 0.3))
    # The swept band, and the lines of all modes within it.
    margin = random.uniform(0.05, 0.3) * f + 3.0 * width
    low, high = max(min(f, f3) - margin, 0.3 * f), max(f + split, f3) + margin
    while True:
        rate = high * random.uniform(2.4, 8.0)
        duration = max(random.uniform(2.0, 5.0) * ring_down, random.uniform(1.0, 3.0) * 1000.0 / f)
        if duration * rate <= _MOST_SAMPLES:
            break
    loss = random.uniform(0.8, 1.25, 2)
    return ForeignGyro(
        (f, f + split, f3),
        (q * loss[0], q * loss[1], q * _log_uniform(random, 0.3, 2.0)),
        random.uniform(-90.0, 90.0),
        (_log_uniform(random, 0.3, 3.0), _log_uniform(random, 0.3, 3.0)),
        (random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05)),
        rate,
        "zoh" if random.uniform() < 0.5 else "foh",
        low,
        high,
        duration,
    )


def drives_of(gyro: ForeignGyro, kind: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive samples (N, 2) [V] of two records to fit and one to hold out."""
    count = round(gyro.duration_s * gyro.rate_hz)
    t, length = np.arange(count) / gyro.rate_hz, count / gyro.rate_hz

    def chirp(start: float, stop: float) -> FloatArray:
        # A sine: what a drive does before its first sample does not matter.
        return np.asarray(np.sin(2.0 * math.pi * (start * t + (stop - start) * t**2 / (2.0 * length))))

    up, down, none = chirp(gyro.low_hz, gyro.high_hz), chirp(gyro.high_hz, gyro.low_hz), np.zeros(count)
    both, swapped = np.stack([up, down], axis=1), np.stack([down, up], axis=1)
    if kind == "alternate":
        return np.stack([up, none], axis=1), np.stack([none, up], axis=1), swapped
    return both, swapped, both


def _held(x: complex, drive: FloatArray, hold: str) -> ComplexArray:
    """int exp(x (n - t)) u(t) dt (N,) at sample n of the held ``drive`` (N,), time in samples: one complex recursion."""
    z = cmath.exp(x)
    if hold == "zoh":
        return np.asarray(lfilter([0.0, (z - 1.0) / x], [1.0, -z], drive))
    ramp = (z - 1.0 - x) / x**2
    return np.asarray(lfilter([ramp, (z - 1.0) / x - ramp], [1.0, -z], drive))


def response(
    gyro: ForeignGyro, drive_v: FloatArray, displacement: bool, electrodes: ElectrodeRows = _PAPER
) -> FloatArray:
    """Noise-free sense samples (N, n) [V] of a device at rest before the record: its velocity or its displacement."""
    (k_s, k_d), (rocking, updown) = gyro.imbalances, gyro.gains
    angle = math.radians(gyro.theta_deg)
    sense, drive = (
        electrodes.gains(k_s)[:, None] * electrodes.senses,
        electrodes.gains(k_d)[:, None] * electrodes.drives,
    )
    c, s = math.cos(angle), math.sin(angle)
    axes = (np.array([c, s, 0.0]), np.array([-s, c, 0.0]), np.array([0.0, 0.0, 1.0]))
    shapes = [(sense @ axis, gain * (drive @ axis)) for axis, gain in zip(axes, (rocking, rocking, updown))]
    volts = np.zeros((drive_v.shape[0], len(sense)))
    for f, q, (a, b) in zip(gyro.frequency_hz, gyro.quality, shapes):
        p = math.pi * f * complex(-1.0 / q, math.sqrt(4.0 - 1.0 / q**2))
        residue = (1.0 if displacement else p) / (p - p.conjugate())
        volts += np.outer(2.0 * (residue * _held(p / gyro.rate_hz, drive_v @ b, gyro.hold)).real / gyro.rate_hz, a)
    return volts


def foreign_campaign(gyro: ForeignGyro, kind: str, random: np.random.Generator) -> Campaign:
    """The campaign of a gyro: silence, two records to fit, one held out."""
    electrodes = LAYOUTS.get(kind, _PAPER)
    drives = list(drives_of(gyro, kind))
    if kind == "four":
        drives = [np.insert(drive, (1, 2), 0.0, axis=1) for drive in drives]
    displacement = kind == "displacement"
    clean = [response(gyro, drive, displacement, electrodes) for drive in drives]
    sigma = _NOISE * np.sqrt(np.mean(clean[0] ** 2 + clean[1] ** 2, axis=0) / 2.0)
    silent = min(drives[0].shape[0], 20_000)
    records = [
        Record(
            "silence",
            gyro.rate_hz,
            np.zeros((silent, len(electrodes.drives))),
            sigma * random.standard_normal((silent, len(electrodes.senses))),
            "noise",
        )
    ]
    for name, role, drive, volts in zip(("a", "b", "c"), ("fit", "fit", "validate"), drives, clean):
        noisy = volts + sigma * random.standard_normal(volts.shape)
        records.append(Record(name, gyro.rate_hz, drive, noisy, role))  # type: ignore[arg-type]
    instrument = Instrument(gyro.rate_hz, gyro.hold, 5.0).with_pickoff("displacement" if displacement else "velocity")
    if kind not in LAYOUTS:
        return Campaign("foreign", tuple(records), instrument)
    layout = layout_of(electrodes.senses.tolist(), electrodes.drives.tolist())
    return Campaign("foreign", tuple(layout.applied(one) for one in records), instrument, frame=layout.frame)


def drawn(seed: int, kind: str, number: int) -> tuple[ForeignGyro, np.random.Generator]:
    """The gyro with this kind and number, and the random stream of its noise."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, list(KINDS).index(kind), number)))
    return draw_gyro(random), random


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of device ``item`` = (kind, number), computed on a worker."""
    kind, number = item
    gyro, random = drawn(seed, kind, number)
    campaign = foreign_campaign(gyro, kind, random)
    row: dict[str, Any] = {"kind": kind, "number": number, "seed": seed, "gyro": asdict(gyro), "failed": ""}
    started = time.process_time()
    with threadpool_limits(limits=1):
        try:
            columns = identify(campaign, seed=seed).columns
        except GyroscreenError as error:
            return row | {"status": "error", "failed": str(error), "cpu_seconds": time.process_time() - started}
    row |= {
        "status": columns["status"],
        "reason": columns["status_reason"],
        "cpu_seconds": time.process_time() - started,
    }
    for name, truth in (("theta_deg", gyro.theta_deg), ("split_hz", gyro.split_hz)):
        if columns.get(f"{name}_sd"):
            away, low, high = offsets(columns, name, truth)
            row[name] = {"z": away / columns[f"{name}_sd"], "inside": low <= 0.0 <= high}
    return row


def run_study(kinds: Sequence[str], devices: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows to the files in ``folder``; yields (done, total).

    Raises
    ------
    UsageError : an unknown kind, or the folder cannot be written.
    """
    return add_rows(study_row, KINDS, kinds, devices, seed, folder, workers)


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Share | str]:
    """Shares of devices that are ok, and of those whose theta and split lie in their 90 % intervals."""
    ok = [row for row in rows if row["status"] == "ok"]
    found: dict[str, Share | str] = {"status ok": Share(len(ok), len(rows))}
    for name, label in (
        ("theta_deg", "theta inside its 90 % interval"),
        ("split_hz", "split inside its 90 % interval"),
    ):
        judged = [row[name]["inside"] for row in ok if name in row]
        found[label] = Share(sum(judged), len(judged))
    return found | processor_times(rows)
