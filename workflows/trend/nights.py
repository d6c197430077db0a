"""The nights of a results folder that can be compared with one of them, and why the others cannot.

A night is comparable if it is complete, tests the same nominal device (or campaigns in the same band), has between half and twice
as many devices, other devices, and at least one that could be identified.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import UsageError
from pipeline.store.columns import with_run
from pipeline.store.folders import PREFIX
from pipeline.store.manifest import Manifest
from pipeline.store.read import find_run, list_runs, read_config
from pipeline.store.run import open_run
from reports.devices import Devices
from reports.limits import Limits
from reports.trend.charted import CHARTED, COMPONENTS, YIELD
from reports.trend.content import LeftOutNight
from reports.trend.night import Night, night_of

from ..config import RunConfig, config_of_run, with_stated_limits
from ..screening.inputs import FILE as INPUTS
from ..screening.inputs import Inputs, read_inputs
from ..screening.settings import population

#: Largest ratio of the numbers of devices of two nights on a chart: its limits hold for nights of about one size.
MOST_RATIO = 2.0


@dataclass(frozen=True)
class StoredNight:
    """A stored run and what it was computed from; ``stated``: its configuration has [limits] of its own."""

    manifest: Manifest
    config: RunConfig
    limits: Limits
    stated: bool

    @property
    def devices(self) -> int:
        """Number of devices."""
        return self.manifest.rows("devices")

    @property
    def run_id(self) -> str:
        """Name of the run."""
        return self.manifest.run_id


@dataclass(frozen=True)
class Selection:
    """The night that is judged, the comparable ones before it, oldest first, and the runs that were left out."""

    tonight: StoredNight
    earlier: tuple[StoredNight, ...]
    left_out: tuple[LeftOutNight, ...]


def stored_night(results: Path, manifest: Manifest) -> StoredNight:
    """A run with its configuration; IntegrityError where it was edited."""
    text = read_config(results / f"{PREFIX}{manifest.run_id}", manifest)
    own = config_of_run(text, f"run.toml of {manifest.run_id}")
    config = with_stated_limits(own)
    return StoredNight(manifest, config, config.judged_by(), bool(own.limits))


def chosen(results: Path, run_id: str | None) -> tuple[StoredNight, tuple[Manifest, ...]]:
    """The run ``run_id`` (``None``, "latest": the newest), and the manifests of the runs before it, oldest first.

    Raises
    ------
    UsageError : there is no such run, or it has no devices.
    """
    folder = find_run(results, run_id)
    runs = list_runs(results)
    names = [manifest.run_id for manifest in runs]
    place = names.index(folder.name.removeprefix(PREFIX))
    night = stored_night(results, runs[place])
    if night.devices == 0:
        raise UsageError(
            "the run has no devices, so there is nothing to compare",
            value=night.run_id,
            next_step="resume it, or name another run",
        )
    return night, runs[:place]


def select(
    results: Path, tonight: StoredNight, runs: Sequence[Manifest], most: int, without: Sequence[str] = ()
) -> Selection:
    """The last ``most`` comparable nights among ``runs`` (oldest first), but for those named in ``without``."""
    unknown = sorted(set(without) - {manifest.run_id for manifest in runs})
    if unknown:
        raise UsageError(
            "--leave-out names no earlier run",
            value=unknown[0],
            allowed=", ".join(manifest.run_id for manifest in runs[-5:]) or "none",
            next_step="correct --leave-out",
        )
    kept: list[StoredNight] = []
    left: list[LeftOutNight] = []
    for manifest in reversed(runs):
        if len(kept) == most:
            break
        night = stored_night(results, manifest)
        reason = "named by --leave-out" if night.run_id in without else why_not(tonight, night, kept)
        if reason:
            left.append(LeftOutNight(night.run_id, reason))
        else:
            kept.append(night)
    other = [
        LeftOutNight(one.run_id, "judged by other limits", (YIELD,)) for one in kept if one.limits != tonight.limits
    ]
    return Selection(tonight, tuple(reversed(kept)), (*left, *other))


def why_not(tonight: StoredNight, night: StoredNight, kept: Sequence[StoredNight] = ()) -> str:
    """Why ``night`` cannot stand on a chart with ``tonight`` and the nights ``kept``; empty if it can."""
    if night.manifest.status != "complete":
        return "not complete"
    other = another_product(tonight.config, night.config)
    if other:
        return other
    if not 1.0 / MOST_RATIO <= night.devices / tonight.devices <= MOST_RATIO:
        return f"{night.devices} devices, not between half and twice the {tonight.devices} of the run"
    for one in (tonight, *kept):
        if same_draws(one.config, night.config):
            return f"the same random numbers as {one.run_id} (seed {night.config.run.seed}): no other night"
    return ""


def another_product(tonight: RunConfig, night: RunConfig) -> str:
    """What makes the devices of two runs another product; empty if nothing does."""
    if tonight.source.kind != night.source.kind:
        return f"devices from {night.source.kind}, not from {tonight.source.kind}"
    if tonight.source.kind == "campaigns":
        bands = [(one.identification.low_hz, one.identification.high_hz) for one in (tonight, night)]
        return "" if bands[0] == bands[1] else f"another band: {bands[1][0]:g} to {bands[1][1]:g} Hz"
    one, other = population(tonight).device, population(night).device
    different = [key for key in one.__struct_fields__ if getattr(one, key) != getattr(other, key)]
    return f"another device: {different[0]} = {getattr(other, different[0])}" if different else ""


def same_draws(one: RunConfig, other: RunConfig) -> bool:
    """Whether the virtual devices of two runs come from the same random numbers, so that they are no independent nights."""
    return one.source.kind == other.source.kind == "population" and one.run.seed == other.run.seed


def charted(limits: Limits) -> tuple[str, ...]:
    """The quantities of the charts: the limited ones, and the components of the anisotropy vector, which stand for theta."""
    return (*(name for name in limits.quantities if name in CHARTED), *COMPONENTS)


def read_night(results: Path, night: StoredNight, names: Sequence[str], identities: bool = False) -> Night:
    """The values of a night; raises as :func:`pipeline.store.columns.with_run`."""
    return with_run(
        results,
        night.run_id,
        lambda run: night_of(Devices(run.devices), night.run_id, night.manifest.created, names, identities),
    )


def inputs_of(results: Path, night: StoredNight) -> Inputs | None:
    """The stored inputs of a run; ``None`` if it stored none."""
    data = open_run(results, night.run_id).page(INPUTS)
    return None if data is None else read_inputs(data, f"{INPUTS} of {night.run_id}")
