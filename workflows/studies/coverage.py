"""Study of the efficiency of the estimates and the coverage of the intervals.

On virtual devices at a signal-to-noise ratio of 60 dB (rms of the 2 s window over white sigma):

    z = (estimate - truth) / sd_CRLB,    sd_CRLB from the Fisher information at the true parameters
    coverage = share of devices whose truth lies inside the 90 % interval

``splits = "small"`` replaces the split of each drawn device by one log-uniform in 0.02 to 0.5 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.axial import difference
from pipeline.device.gyro import split_hz, to_cartesian, to_physical
from pipeline.errors import UsageError
from pipeline.inference.screening.compressed import BandData
from pipeline.inference.screening.fit import information_covariance
from populations.draw import Draw, draw
from reports.yields import clopper_pearson

from ..config import RunConfig, load_config
from ..config_tables import NoiseTable
from ..machine import worker_count
from ..screening.cluster import cluster, in_parallel
from ..screening.settings import population
from ..screening.virtual_device import identify_virtual, physical_of, shared_record, virtual_records

Splits = Literal["population", "small"]
_SPLIT_STREAM = 104
_BLOCK = 10
_STEP = 1e-6


@dataclass(frozen=True)
class Row:
    """One device: true split [Hz], status, errors in units of the Cramer-Rao sd, coverage, size of the posterior."""

    split_hz: float
    status: str
    z_theta: float
    z_split: float
    theta_inside: bool
    split_inside: bool
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


def study_config(seed: int, devices: int) -> RunConfig:
    """The default run at 60 dB, no draws stored."""
    config = load_config(None, {"seed": seed, "devices": devices})
    posterior = msgspec.structs.replace(config.posterior, stored_draws=0)
    return msgspec.structs.replace(config, noise=NoiseTable(snr_db=60.0), posterior=posterior)


def with_small_splits(drawn: Draw, seed: int) -> Draw:
    """The same devices, each with a split drawn log-uniformly from 0.02 to 0.5 Hz."""
    uniform = [
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SPLIT_STREAM, int(n)))).uniform()
        for n in drawn.index
    ]
    split = 0.02 * 25.0 ** np.array(uniform)
    true = dict(drawn.true)
    true["split_hz"] = split
    true["f2_hz"] = true["f1_hz"] + split
    return replace(drawn, true=true)


def bound_sd(config: RunConfig, physical: FloatArray, sigma_v: FloatArray) -> tuple[float, float]:
    """Cramer-Rao sd of theta [deg] and split [Hz] of one device: ``physical`` (12,), ``sigma_v`` (2,) [V]."""
    shared = shared_record(config)
    data = BandData(shared.band, np.zeros((2, shared.band.bins.size), dtype=np.complex128), shared.nuisance)
    x = to_cartesian(physical[None])[0]
    covariance = information_covariance([data], sigma_v, x)
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


def study_block(job: tuple[RunConfig, Splits], span: tuple[int, int]) -> list[Row]:
    """Rows of the devices first .. first + count - 1, where span = (first, count)."""
    config, splits = job
    first, count = span
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = draw(spec, config.run.seed, first, count)
        if splits == "small":
            drawn = with_small_splits(drawn, config.run.seed)
        return [_row(config, drawn, i, float(spec.angular_gain)) for i in range(count)]


def _row(config: RunConfig, drawn: Draw, i: int, gain: float) -> Row:
    result = identify_virtual(config, drawn, i, gain)
    theta, split = float(drawn.true["theta_deg"][i]), float(drawn.true["split_hz"][i])
    if result.fit is None:
        return Row(split, result.estimate.status, np.nan, np.nan, False, False, 0.0)
    _, _, sigma = virtual_records(config, drawn, i)
    adc = config.instrument.instrument().adc
    total = np.sqrt(sigma**2 + (adc.lsb_v**2 / 12.0 if adc else 0.0))
    sd_theta, sd_split = bound_sd(config, physical_of(drawn.true)[i], np.full(2, total))
    c: dict[str, Any] = result.columns
    off = float(difference(c["theta_deg"], theta))
    low = float(difference(c["theta_deg_q05"], theta))
    high = float(difference(c["theta_deg_q95"], theta))
    return Row(
        split,
        result.estimate.status,
        off / sd_theta,
        (c["split_hz"] - split) / sd_split,
        low <= 0.0 <= high,
        c["split_hz_q05"] <= split <= c["split_hz_q95"],
        c["ess"],
    )


def run_study(devices: int, splits: str, seed: int, workers: int) -> list[Row]:
    """Rows of all devices, in their order; ``splits`` is "population" or "small".

    Raises
    ------
    UsageError : unknown kind of splits, or no devices.
    """
    if splits not in ("population", "small"):
        raise UsageError("unknown splits", value=splits, allowed="population, small")
    if devices < 1:
        raise UsageError("no devices to study", value=devices, allowed="1 or more")
    config = study_config(seed, devices)
    spans = [(first, min(_BLOCK, devices - first)) for first in range(0, devices, _BLOCK)]
    found: list[Row] = []
    with cluster(min(worker_count(workers), len(spans)), None) as client:
        for rows in in_parallel(client, study_block, (config, splits), spans):
            found += rows
    return found


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures of the study by name; shares as :class:`Share`."""
    resolved = [r for r in rows if r.split_hz >= 0.05 and np.isfinite(r.z_theta)]
    wide = [r for r in rows if r.split_hz >= 0.2 and np.isfinite(r.z_theta)]
    tenth = [r for r in rows if r.split_hz >= 0.1]
    return {
        "devices": len(rows),
        "without a row": sum(not r.status for r in rows),
        "theta inside its 90 % interval, split >= 0.05 Hz": Share(sum(r.theta_inside for r in resolved), len(resolved)),
        "split inside its 90 % interval, split >= 0.05 Hz": Share(sum(r.split_inside for r in resolved), len(resolved)),
        "rms (theta - truth)/CRLB, split >= 0.2 Hz": _rms([r.z_theta for r in wide]),
        "rms (split - truth)/CRLB, split >= 0.2 Hz": _rms([r.z_split for r in wide]),
        "status ok, split >= 0.1 Hz": Share(sum(r.status == "ok" for r in tenth), len(tenth)),
        "status ok, all": Share(sum(r.status == "ok" for r in rows), len(rows)),
        "least ESS of a device": min((r.ess for r in rows if r.status == "ok"), default=float("nan")),
    }
