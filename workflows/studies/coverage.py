"""Study of the efficiency of the estimates and the coverage of the intervals.

On virtual devices at a signal-to-noise ratio of 60 dB (rms of the 2 s window over sigma), or with noise of another kind:

    z = (estimate - truth) / sd_CRLB,    sd_CRLB from the Fisher information at the true parameters, white noise only
    coverage = share of devices whose truth lies inside the 90 % interval

``splits = "small"`` replaces the split of each drawn device by one log-uniform in 0.02 to 0.5 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.axial import difference
from pipeline.device.gyro import split_hz, to_cartesian, to_physical
from pipeline.errors import UsageError
from pipeline.experiment.bad_samples import MOST_BAD
from pipeline.experiment.noise.source import Kind
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.estimate import quantities
from pipeline.inference.screening.campaign import identify_campaign
from pipeline.inference.screening.compressed import BandData
from pipeline.inference.screening.fit import information_covariance
from pipeline.inference.screening.mismatch import with_mismatch
from pipeline.inference.screening.result import DeviceResult
from pipeline.quantities import AXES
from populations.draw import Draw, draw
from reports.yields import clopper_pearson

from ..config import RunConfig, load_config
from ..config_bench import NoiseTable
from ..process import worker_count
from ..screening.cluster import cluster
from ..screening.dispatch import in_parallel
from ..screening.settings import POSTERIOR_STREAM, device_seed, population, rate_of, settings_of
from ..screening.virtual_device import identify_virtual, physical_of, shared_record, virtual_records
from .spoil import spoilt

Splits = Literal["population", "small"]
_SPLIT_STREAM, _BAD_STREAM = 104, 109
_BLOCK = 10
#: Quantities whose intervals are checked, and what the figures call them.
COVERED = {"theta_deg": "theta", "split_hz": "split", "zeta1": "zeta1", "rate_bias_dps": "rate bias"}
_STEP = 1e-6


@dataclass(frozen=True)
class Row:
    """One device: true split [Hz], status, errors in units of the Cramer-Rao sd, size of the posterior.

    ``inside`` names the quantities of ``COVERED`` whose truth lies inside the 90 % interval.
    """

    split_hz: float
    status: str
    z_theta: float
    z_split: float
    inside: frozenset[str]
    ess: float


@dataclass(frozen=True)
class Share:
    """count of total, with its 95 % Clopper-Pearson interval."""

    count: int
    total: int

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Clopper-Pearson interval of count / total."""
        found = clopper_pearson(self.count, self.total)
        return found.low, found.high

    def __str__(self) -> str:
        if not self.total:
            return "none"
        low, high = self.interval
        return f"{100 * self.count / self.total:.1f} % ({self.count}/{self.total}, {100 * low:.1f} to {100 * high:.1f})"


def study_config(seed: int, devices: int, noise: Kind = "white") -> RunConfig:
    """The default run, no draws stored: white noise at 60 dB, or the default level with another kind of ``noise``."""
    config = load_config(None, {"seed": seed, "devices": devices})
    posterior = msgspec.structs.replace(config.posterior, stored_draws=0)
    level = NoiseTable(snr_db=60.0) if noise == "white" else msgspec.structs.replace(config.noise, kind=noise)
    return msgspec.structs.replace(config, noise=level, posterior=posterior)


def with_small_splits(drawn: Draw, seed: int) -> Draw:
    """The same devices, each with a split drawn log-uniformly from 0.02 to 0.5 Hz."""
    uniform = [
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SPLIT_STREAM, int(n)))).uniform()
        for n in drawn.index
    ]
    return with_splits(drawn, 0.02 * 25.0 ** np.array(uniform))


def with_splits(drawn: Draw, split: FloatArray) -> Draw:
    """The same devices with other splits (B,) [Hz]."""
    return replace(drawn, true={**drawn.true, "split_hz": split, "f2_hz": drawn.true["f1_hz"] + split})


def bound_sd(config: RunConfig, physical: FloatArray, sigma_v: FloatArray) -> tuple[float, float]:
    """Cramer-Rao sd of theta [deg] and split [Hz] of one device: ``physical`` (12,), ``sigma_v`` (2,) [V]."""
    shared = shared_record(config)
    data = BandData(shared.band, np.zeros((2, shared.band.bins.size), dtype=np.complex128), shared.nuisance)
    prior = settings_of(config).mismatch
    x = to_cartesian(physical[None])[0]
    # The bound depends on the mismatches only in second order, so it is taken at the mean of their prior.
    at = x if prior is None else with_mismatch(x, prior)
    covariance = information_covariance([data], sigma_v, at, prior)[: x.size, : x.size]
    slope = np.zeros((2, x.size))
    for i in (0, 1, 2):
        ahead, behind = x.copy(), x.copy()
        ahead[i] += _STEP
        behind[i] -= _STEP
        pair = np.stack([ahead, behind])
        theta, split = to_physical(pair)[:, 6], split_hz(pair)
        slope[0, i] = float(difference(theta[0], theta[1])) / (2.0 * _STEP)
        slope[1, i] = (split[0] - split[1]) / (2.0 * _STEP)
    variance = np.einsum("qi,ij,qj->q", slope, covariance, slope)
    return float(np.sqrt(variance[0])), float(np.sqrt(variance[1]))


def bounds_of(config: RunConfig, drawn: Draw, i: int) -> tuple[float, float]:
    """Cramer-Rao sd of theta [deg] and split [Hz] of device ``i``, for the white noise of its records and of the ADC."""
    _, _, sigma = virtual_records(config, drawn, i)
    adc = config.instrument.instrument().adc
    total = np.sqrt(sigma**2 + (adc.lsb_v**2 / 12.0 if adc else 0.0))
    return bound_sd(config, physical_of(drawn.true)[i], np.full(2, total))


def study_block(job: tuple[RunConfig, Splits, float], span: tuple[int, int]) -> list[Row]:
    """Rows of the devices first .. first + count - 1, where span = (first, count); job = (run, splits, bad samples)."""
    config, splits, bad = job
    first, count = span
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = draw(spec, config.run.seed, first, count)
        if splits == "small":
            drawn = with_small_splits(drawn, config.run.seed)
        return [_row(config, drawn, i, float(spec.angular_gain), bad) for i in range(count)]


def _identified_with_bad_samples(config: RunConfig, drawn: Draw, i: int, gain: float, bad: float) -> DeviceResult:
    """Device ``i``, measured with a share ``bad`` of bad samples, identified like a campaign of a nightly run."""
    instrument, rate = config.instrument.instrument(), config.instrument.sample_rate_hz
    silent, fit, _ = virtual_records(config, drawn, i)
    random = np.random.default_rng(device_seed(config, _BAD_STREAM, int(drawn.index[i])))
    silent, fit = (spoilt(y, bad, instrument.adc, random) for y in (silent, fit))
    records = (
        Record("silence", rate, np.zeros_like(silent), silent, role="noise"),
        Record("chirp", rate, shared_record(config).record.drive_v, fit, role="fit"),
    )
    demodulation = config.demodulation
    campaign = Campaign(
        drawn.device_id[i], records, instrument, gain, demodulation.phase_error_deg, drive=demodulation.drive
    )
    seed = device_seed(config, POSTERIOR_STREAM, int(drawn.index[i]))
    return identify_campaign(campaign, settings_of(config), config.posterior.settings(), config.judging_gate(), seed)


def _row(config: RunConfig, drawn: Draw, i: int, gain: float, bad: float) -> Row:
    identified = partial(_identified_with_bad_samples, bad=bad) if bad > 0.0 else identify_virtual
    result = identified(config, drawn, i, gain)
    split = float(drawn.true["split_hz"][i])
    if result.fit is None:
        return Row(split, result.estimate.status, np.nan, np.nan, frozenset(), 0.0)
    physical = physical_of(drawn.true)[i]
    truth = quantities(physical, rate_of(config, gain), drawn.true["split_hz"][i])
    c: dict[str, Any] = result.columns
    z_theta = z_split = np.nan
    if config.noise.kind == "white":
        sd_theta, sd_split = bounds_of(config, drawn, i)
        z_theta = float(difference(c["theta_deg"], truth["theta_deg"])) / sd_theta
        z_split = (c["split_hz"] - split) / sd_split
    inside = frozenset(name for name in COVERED if _inside(c, name, float(truth[name])))
    return Row(split, result.estimate.status, z_theta, z_split, inside, c["ess"])


def offsets(columns: Mapping[str, Any], name: str, truth: float) -> tuple[float, float, float]:
    """Estimate, low and high end of its 90 % interval minus the ``truth``, in the unit of the quantity; axes modulo 180 deg."""
    found = np.array([columns[name], columns[f"{name}_q05"], columns[f"{name}_q95"]])
    error, low, high = (difference(found, truth) if name in AXES else found - truth).tolist()
    return error, low, high


def _inside(columns: Mapping[str, Any], name: str, truth: float) -> bool:
    _, low, high = offsets(columns, name, truth)
    return low <= 0.0 <= high


def run_study(devices: int, splits: str, seed: int, workers: int, noise: str = "white", bad: float = 0.0) -> list[Row]:
    """Rows of all devices, in their order.

    ``splits`` is "population" or "small", ``noise`` a kind of the [noise] table, ``bad`` a share of bad samples in each record.

    Raises
    ------
    UsageError : unknown kind of splits or of noise, no devices, or more bad samples than a record may have.
    """
    kinds: dict[str, Kind] = {kind: kind for kind in get_args(Kind)}
    if noise not in kinds:
        raise UsageError("unknown kind of noise", value=noise, allowed=", ".join(kinds))
    if splits not in ("population", "small"):
        raise UsageError("unknown splits", value=splits, allowed="population, small")
    if not 0.0 <= bad <= MOST_BAD:
        raise UsageError("no such share of bad samples", value=bad, allowed=f"0 to {MOST_BAD:g}")
    if devices < 1:
        raise UsageError("no devices to study", value=devices, allowed="1 or more")
    config = study_config(seed, devices, kinds[noise])
    spans = [(first, min(_BLOCK, devices - first)) for first in range(0, devices, _BLOCK)]
    found: list[Row] = []
    with cluster(min(worker_count(workers), len(spans)), None) as client:
        for rows in in_parallel(client, study_block, (config, splits, bad), spans):
            found += rows
    return found


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures of the study by name; shares as :class:`Share`."""
    resolved = [r for r in rows if r.split_hz >= 0.05 and r.status != "fit_failed"]
    wide = [r for r in rows if r.split_hz >= 0.2 and np.isfinite(r.z_theta)]
    tenth = [r for r in rows if r.split_hz >= 0.1]
    inside = {
        f"{label} inside its 90 % interval, split >= 0.05 Hz": Share(
            sum(name in r.inside for r in resolved), len(resolved)
        )
        for name, label in COVERED.items()
    }
    return {
        "devices": len(rows),
        "without a row": sum(not r.status for r in rows),
        **inside,
        "rms (theta - truth)/CRLB, split >= 0.2 Hz": _rms([r.z_theta for r in wide]),
        "rms (split - truth)/CRLB, split >= 0.2 Hz": _rms([r.z_split for r in wide]),
        "status ok, split >= 0.1 Hz": Share(sum(r.status == "ok" for r in tenth), len(tenth)),
        "status ok, all": Share(sum(r.status == "ok" for r in rows), len(rows)),
        "least ESS of a device": min((r.ess for r in rows if r.status == "ok"), default=float("nan")),
    }
