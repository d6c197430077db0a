"""A block of devices: identified and judged, as two tables.

A block is a pure function of the configuration and of its device numbers, so workers, block sizes and resumption cannot change
a result.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.errors import GyroscreenError
from pipeline.experiment.antialias import Bank
from pipeline.inference.estimate import identified_quantities, quantities
from pipeline.inference.screening.result import DeviceResult, Fitted, failed_result, lost_result, results_of
from pipeline.quantities import NAMES, PERFORMANCE
from pipeline.store.schema import devices_table
from populations.draw import Draw, draw
from reports.decision import conforms
from reports.limits import Limits

from ..config import RunConfig
from .drawn_table import drawn_table
from .guard import Begin, unguarded
from .judging import JudgedDevice, judged_devices, posterior_of
from .settings import TRIM_STREAM, device_seed, population, rate_of, with_true_noise
from .trimming import trimmed_columns
from .virtual_device import fit_virtual, physical_of, virtual_banks

#: Devices of a block that are scored together.  Blocks of 25 in groups of 5, 8, 12 and 25 take the same time within 2 %; a device
#: that waits for its group holds 2 MB.
_TOGETHER = 5
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
    config: RunConfig, block: DeviceBlock, drawn: Draw, angular_gain: float, begin: Begin, devices: range
) -> list[DeviceResult]:
    """Of some devices of a block, which are scored together."""
    if block.lost:
        return [lost_result(block.lost)] * len(devices)
    fitted: list[Fitted | DeviceResult] = []
    banks: Sequence[Bank | None] = ()
    for i in devices:
        begin(block.first + i)
        banks = banks or _banks(config, drawn, devices)
        fitted.append(_fitted(config, drawn, i, angular_gain, banks[i - devices.start]))
    return _finished(fitted)


def groups_of(count: int, most: int = _TOGETHER) -> list[range]:
    """Devices 0 .. ``count`` - 1 in groups as equal as possible of about ``most``: a device alone takes 1.3 times as long."""
    groups = max(round(count / most), 1)
    edges = [count * k // groups for k in range(groups + 1)]
    return [range(first, last) for first, last in pairwise(edges)]


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


def tables_of(
    index: int, device_id: Sequence[str], fixed: Mapping[str, Any], devices: Sequence[JudgedDevice]
) -> BlockTables:
    """The tables of a block.

    Parameters
    ----------
    index : number of the block.
    device_id, devices : of each device.
    fixed : further columns by name, one value per device.
    """
    names = sorted({name for device in devices for name in device.columns})
    columns: dict[str, Any] = {name: [device.columns.get(name) for device in devices] for name in names}
    table = devices_table({"device_id": list(device_id), **fixed, **columns})
    stored = any(device.draws is not None for device in devices)
    posterior = posterior_of(device_id, [device.draws for device in devices]) if stored else None
    return BlockTables(index, table, posterior, dict(Counter(device.status for device in devices)))


def _with_trim(
    config: RunConfig, limits: Limits, results: Sequence[DeviceResult], drawn: Draw, gain: float, devices: range
) -> list[DeviceResult]:
    """The results of some devices with their trim columns, if the run has a [trim]."""
    if config.trim is None:
        return list(results)
    physical, rate = physical_of(drawn.true), rate_of(config, gain)
    out = []
    for i, result in zip(devices, results):
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
        limits = config.judged_by()
        found: list[JudgedDevice] = []
        for devices in groups_of(block.count):
            # No name holds the results of a group while the next one is identified: they are 5 MB.
            found += judged_devices(
                _with_trim(config, limits, _results(config, block, drawn, gain, begin, devices), drawn, gain, devices),
                limits,
                config.posterior.stored_draws,
            )
        truth = truth_columns(config, drawn, gain)
        fixed = {
            "lot": list(drawn.lot),
            "wafer": list(drawn.wafer),
            "die_x_mm": drawn.die_x_mm,
            "die_y_mm": drawn.die_y_mm,
            "package": list(drawn.package),
            "cause": _causes(limits, truth),
            **truth,
        }
        tables = tables_of(block.index, drawn.device_id, fixed, found)
        return replace(tables, irregularities=drawn_table(drawn)) if config.source.store_irregularities else tables
