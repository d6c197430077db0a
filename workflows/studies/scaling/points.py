"""The points of the scaling study: what is varied, its values, and the configuration of each point."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from pipeline.errors import UsageError

from ...config import RunConfig
from ...config_tables import DiagnosisTable, RunTable

#: What is varied: its values, the numbers of workers, and the meaning in words.
STUB, BLOCK, DRAWS, DEVICE = "stub", "block", "draws", "device"
ORDER, DURATION, RECORDS = "order", "duration", "records"
VALUES: dict[str, tuple[tuple[float, ...], tuple[int, ...]]] = {
    DEVICE: ((100, 1000), (1, 2)),
    ORDER: ((10, 20, 40, 80), (0,)),
    DURATION: ((0.5, 1.0, 2.0, 3.0, 4.0, 6.0), (0,)),
    RECORDS: ((1, 2, 4, 8), (0,)),
    BLOCK: ((25, 100, 250, 1000), (1,)),
    DRAWS: ((0, 100), (1,)),
    STUB: ((100, 1000, 10_000, 100_000, 1_000_000), (1, 2)),
}
#: Devices of a point whose value is not their number.
_DEVICES = {ORDER: 16, DURATION: 16, RECORDS: 8, BLOCK: 10_000, DRAWS: 10_000}
#: Devices of a block of stubs: 10 s of real devices, the upper end of what a block should take.
STUB_BLOCK = 250


@dataclass(frozen=True)
class Point:
    """One measurement: ``value`` of what ``kind`` varies, local workers (0: in the process itself), and devices."""

    kind: str
    value: float
    workers: int

    @property
    def number(self) -> str:
        """Its name among the points of its kind."""
        return f"{self.value:g} x {self.workers}"

    @property
    def devices(self) -> int:
        """Devices of the run."""
        return _DEVICES.get(self.kind, int(self.value))


def points_of(kind: str, largest: int) -> tuple[Point, ...]:
    """The points of one kind, or of all; runs of more than ``largest`` devices are left out.

    Raises
    ------
    UsageError : no such kind.
    """
    if kind != "all" and kind not in VALUES:
        raise UsageError("no such kind of point", value=kind, allowed=f"all, {', '.join(VALUES)}")
    kinds = VALUES if kind == "all" else (kind,)
    found = [Point(k, value, workers) for k in kinds for value in VALUES[k][0] for workers in VALUES[k][1]]
    return tuple(point for point in found if point.devices <= largest)


def config_of_point(point: Point, seed: int) -> RunConfig:
    """The default run with what the point varies."""
    base = RunConfig()
    block = base.run.block
    if point.kind in (STUB, DRAWS):
        block = min(STUB_BLOCK, max(point.devices // 4, 1))
    elif point.kind == BLOCK:
        block = int(point.value)
    elif point.workers == 0:
        block = point.devices
    config = msgspec.structs.replace(
        base, run=RunTable(devices=point.devices, seed=seed, block=block), diagnosis=DiagnosisTable(enabled=False)
    )
    if point.kind in (STUB, BLOCK):
        return msgspec.structs.replace(config, posterior=msgspec.structs.replace(config.posterior, stored_draws=0))
    if point.kind == DRAWS:
        draws = int(point.value)
        return msgspec.structs.replace(config, posterior=msgspec.structs.replace(config.posterior, stored_draws=draws))
    if point.kind == ORDER:
        order = int(point.value)
        return msgspec.structs.replace(
            config, identification=msgspec.structs.replace(config.identification, order=order)
        )
    if point.kind == DURATION:
        experiment = msgspec.structs.replace(config.experiment, duration_s=point.value)
        return msgspec.structs.replace(config, experiment=experiment)
    return config
