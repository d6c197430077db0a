"""A block of devices: identified and judged, as two tables.

A block is a pure function of the configuration and of its device numbers, so workers, block sizes and resumption cannot change
a result.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.errors import GyroscreenError
from pipeline.experiment.antialias import Bank
from pipeline.inference.estimate import identified_quantities, quantities
from pipeline.inference.screening.result import DeviceResult, Fitted, failed_result, lost_result, results_of
from pipeline.inference.systematic import Identified, common_nodes
from pipeline.quantities import MODEL, NAMES, PERFORMANCE
from pipeline.store.schema import devices_table, posterior_table
from populations.draw import Draw, draw
from reports.decision import conformity, conforms, decide
from reports.limits import Limits

from ..config import RunConfig
from .drawn_table import drawn_table
from .guard import Begin, unguarded
from .settings import TRIM_STREAM, device_seed, population, rate_of, with_true_noise
from .trimming import trimmed_columns
from .virtual_device import fit_virtual, physical_of, virtual_banks

#: Posterior draws at each common error: P(conform) in steps of 1/200, a tenth of the rule's 0.05.
DRAWS_GIVEN_COMMON = 200

#: Devices of a block that are scored together: 8 save all that 16 save, and hold 7 MB (16: 16 MB).
_TOGETHER = 8
#: What ends a device, not the run.
_FAILURES = (GyroscreenError, ArithmeticError, ValueError, MemoryError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class DeviceBlock:
    """Block ``index`` contains the devices first .. first + count - 1 of the run.

    ``lost`` says why they were given up; empty if they are to be identified.
    """

    index: int
    first: int
    count: int
    lost: str = ""


@dataclass(frozen=True, eq=False)
class BlockTables:
    """The result of a block: devices, posterior draws and drawn irregularities (``None`` if not stored), counts by status."""

    index: int
    devices: pa.Table
    posterior: pa.Table | None
    statuses: dict[str, int]
    irregularities: pa.Table | None = None


def blocks_of(config: RunConfig, devices: int) -> tuple[DeviceBlock, ...]:
    """The devices 0 .. ``devices`` - 1 of a run, divided into blocks of ``run.block`` devices."""
    size = config.run.block
    return tuple(DeviceBlock(i, i * size, min(size, devices - i * size)) for i in range(-(-devices // size)))


def _banks(config: RunConfig, drawn: Draw, devices: range) -> Sequence[Bank | None]:
    # Where one of the devices fails, each is tried alone, so that the others are not affected.
    try:
        return virtual_banks(config, drawn, devices) or [None] * len(devices)
    except _FAILURES:
        return [None] * len(devices)


def _fitted(config: RunConfig, drawn: Draw, i: int, angular_gain: float, bank: Bank | None) -> Fitted | DeviceResult:
    # One device that fails must not stop the run; its row states the reason.
    try:
        return fit_virtual(config, drawn, i, angular_gain, bank)
    except _FAILURES as error:
        return _failed(error)


def _failed(error: Exception) -> DeviceResult:
    return failed_result(f"{type(error).__name__}: {error}")


def _finished(fitted: Sequence[Fitted | DeviceResult]) -> list[DeviceResult]:
    results = []
    for result in results_of(fitted):
        if isinstance(result, _FAILURES):
            result = _failed(result)
        if isinstance(result, Exception):
            raise result
        results.append(result)
    return results


def _results(
    config: RunConfig, block: DeviceBlock, drawn: Draw, angular_gain: float, begin: Begin
) -> list[DeviceResult]:
    if block.lost:
        return [lost_result(block.lost)] * block.count
    kept = {*(q.name for q in MODEL), *config.judged_by().quantities}
    results: list[DeviceResult] = []
    for first in range(0, block.count, _TOGETHER):
        devices = range(first, min(first + _TOGETHER, block.count))
        fitted: list[Fitted | DeviceResult] = []
        banks: Sequence[Bank | None] = ()
        for i in devices:
            begin(block.first + i)
            banks = banks or _banks(config, drawn, devices)
            fitted.append(_fitted(config, drawn, i, angular_gain, banks[i - first]))
        results += [_slim(result, kept) for result in _finished(fitted)]
    return results


def _slim(result: DeviceResult, names: Collection[str]) -> DeviceResult:
    """The result with the draws of these quantities only: all draws of a block of 25 take 17 MB."""
    draws = {name: values for name, values in result.estimate.draws.items() if name in names}
    return replace(result, estimate=replace(result.estimate, draws=draws))


def truth_columns(config: RunConfig, drawn: Draw, angular_gain: float) -> dict[str, FloatArray]:
    """fab_<q> and true_<q>, each (B,) in the unit of its column, of a draw: as fabricated and as packaged."""
    out: dict[str, FloatArray] = {}
    for prefix, values in (("fab", drawn.fab), ("true", drawn.true)):
        all_q = true_quantities(config, values, angular_gain)
        out |= {f"{prefix}_{name}": all_q[name] for name in NAMES}
    return out


def true_quantities(
    config: RunConfig,
    values: Mapping[str, FloatArray],
    angular_gain: float,
    needed: Collection[str] = tuple(NAMES),
) -> dict[str, FloatArray]:
    """Result quantities (B,) of devices with the parameters ``values`` (B,) by name, without an error of measurement.

    All of them, or those that do not depend on the operation where these are all that is ``needed``.
    """
    rate = with_true_noise(config, rate_of(config, angular_gain))
    found = quantities if any(q.name in needed for q in PERFORMANCE) else identified_quantities
    return found(physical_of(values), rate, values["split_hz"])


def _causes(limits: Limits, truth: Mapping[str, FloatArray]) -> list[str | None]:
    """The stage at which each device's true values first fail the limits; ``None`` if they do not."""
    fab = conforms(limits, {q: truth[f"fab_{q}"] for q in limits.quantities})
    true = conforms(limits, {q: truth[f"true_{q}"] for q in limits.quantities})
    return [None if t else ("packaging" if f else "fabrication") for f, t in zip(fab, true)]


def judged(results: Sequence[DeviceResult], limits: Limits) -> dict[str, list[Any]]:
    """p_pass, verdict and failed_limits of each result, by column name."""
    unknown = np.full(1, np.nan)
    draws = [{q: result.estimate.draws.get(q, unknown) for q in limits.quantities} for result in results]
    # Devices with equal numbers of draws are judged together.
    alike: dict[tuple[int, ...], list[int]] = {}
    for i, own in enumerate(draws):
        alike.setdefault(tuple(values.size for values in own.values()), []).append(i)
    out: dict[str, list[Any]] = {name: [None] * len(results) for name in ("p_pass", "verdict", "failed_limits")}
    for places in alike.values():
        stacked = {q: np.stack([draws[i][q] for i in places]) for q in limits.quantities}
        found = decide(limits, stacked, [results[i].estimate.status for i in places])
        for i, p_pass, verdict, failed in zip(places, found.p_pass.tolist(), found.verdict, found.failed_limits):
            out["p_pass"][i], out["verdict"][i], out["failed_limits"][i] = p_pass, verdict, failed
    return out


def tables_of(
    index: int,
    device_id: Sequence[str],
    fixed: Mapping[str, Any],
    results: Sequence[DeviceResult],
    limits: Limits,
    stored_draws: int,
) -> BlockTables:
    """The tables of a block.

    Parameters
    ----------
    index : number of the block.
    device_id, results : of each device.
    fixed : further columns by name, one value per device.
    limits : by which the devices are judged.
    stored_draws : largest number of posterior draws kept per device.
    """
    names = sorted({name for result in results for name in result.columns})
    columns: dict[str, Any] = {name: [result.columns.get(name) for result in results] for name in names}
    devices = devices_table({"device_id": list(device_id), **fixed, **columns, **judged(results, limits)})
    statuses: dict[str, int] = {}
    for result in results:
        status = result.estimate.status
        statuses[status] = statuses.get(status, 0) + 1
    posterior = _posterior(device_id, results, limits, stored_draws) if stored_draws else None
    return BlockTables(index, devices, posterior, statuses)


def p_pass_given_common(limits: Limits, identified: Identified, nodes: FloatArray) -> FloatArray:
    """P(conform) (K,) of a device at each of K common errors, ``nodes`` (K, 5) [sd]; nan where it is unknown."""
    count = identified.split_hz.size
    kept = np.linspace(0, count - 1, min(DRAWS_GIVEN_COMMON, count)).round().astype(np.int64)
    draws = identified.thinned(kept).given(np.broadcast_to(nodes[:, None], (nodes.shape[0], kept.size, nodes.shape[1])))
    return conformity(limits, {q: draws[q] for q in limits.quantities}).p_pass


def _posterior(
    device_id: Sequence[str], results: Sequence[DeviceResult], limits: Limits, stored_draws: int
) -> pa.Table:
    """At most ``stored_draws`` draws of each device, evenly spaced along its chains; P(conform) at that many common errors."""
    parts: dict[str, list[Any]] = {"device_id": [], "draw": [], **{q.name: [] for q in MODEL}}
    parts["p_pass_given_common"] = []
    for identity, result in zip(device_id, results):
        draws = result.estimate.draws
        if not draws:
            continue
        total = draws["theta_deg"].size
        kept = np.linspace(0, total - 1, min(stored_draws, total)).round().astype(np.int64)
        parts["device_id"] += [identity] * kept.size
        parts["draw"].append(np.arange(kept.size, dtype=np.int32))
        for q in MODEL:
            parts[q.name].append(draws[q.name][kept])
        given = np.full(kept.size, np.nan)
        if result.identified is not None and result.estimate.status == "ok":
            given = p_pass_given_common(limits, result.identified, common_nodes(kept.size))
        parts["p_pass_given_common"].append(given)
    return posterior_table({k: (v if k == "device_id" else np.concatenate(v) if v else []) for k, v in parts.items()})


def _with_trim(
    config: RunConfig, limits: Limits, results: Sequence[DeviceResult], drawn: Draw, gain: float
) -> list[DeviceResult]:
    """The results with their trim columns, if the run has a [trim]."""
    if config.trim is None:
        return list(results)
    physical, rate = physical_of(drawn.true), rate_of(config, gain)
    out = []
    for i, result in enumerate(results):
        seed = device_seed(config, TRIM_STREAM, int(drawn.index[i]))
        more = trimmed_columns(config.trim, limits, result, physical[i], rate, seed)
        out.append(replace(result, columns={**result.columns, **more}))
    return out


def virtual_block(config: RunConfig, block: DeviceBlock, begin: Begin = unguarded) -> BlockTables:
    """Draw, simulate, identify and judge the virtual devices of ``block``; ``begin`` is called before each."""
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = draw(spec, config.run.seed, block.first, block.count)
        gain = float(spec.angular_gain)
        results = _results(config, block, drawn, gain, begin)
        truth = truth_columns(config, drawn, gain)
        limits = config.judged_by()
        results = _with_trim(config, limits, results, drawn, gain)
        fixed = {
            "lot": list(drawn.lot),
            "wafer": list(drawn.wafer),
            "die_x_mm": drawn.die_x_mm,
            "die_y_mm": drawn.die_y_mm,
            "package": list(drawn.package),
            "cause": _causes(limits, truth),
            **truth,
        }
        found = tables_of(block.index, drawn.device_id, fixed, results, limits, config.posterior.stored_draws)
        return replace(found, irregularities=drawn_table(drawn)) if config.source.store_irregularities else found
