"""The content of a run's page: frozen data, from verified tables; no HTML, no figures.

tables + limits -> RunContent -> page
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from pipeline.errors import ConfigError
from pipeline.quantities import NAMES, QUANTITIES, Quantity

from ..capability import Capability, Common, capabilities
from ..clusters import Clustering, clustering
from ..common_errors import (
    GivenCommon,
    clustering_with_common,
    given_common,
    groups_with_common,
    measurement_given_common,
    with_common,
)
from ..decision_risk import K_CURVE, DecisionRisk, RiskCurve, decision_risks, risk_curve
from ..devices import ColumnSource, Devices
from ..limits import Limits
from ..words.night import status_cause
from ..words.quantities import cause_sentence, main_cause, process_sentence, stage_sentence, undecided_sentence
from ..yields import (
    GroupYield,
    Measurement,
    Yield,
    by_group,
    measurement_uncertainty,
    yield_of_verdicts,
)
from .calibration import Coverage, VerdictCheck, check_verdicts, coverage
from .causes import Pareto, StageLoss, pareto, stage_losses
from .health import RouteDifference, Spread, StatusCount, route_differences, spreads, status_counts
from .lot_effects import LotEffects, NeededEffects, needed_effects
from .trim import TrimYield, trim_yield, true_conformity
from .undetected import BiasBound, bias_bound
from .worst import WorstDevice, worst_devices


class ReportedRun(Protocol):
    """The parts of a run that its page needs: verified tables, manifest and configuration."""

    @property
    def devices(self) -> ColumnSource:
        """The ``devices`` table."""

    @property
    def posterior(self) -> ColumnSource | None:
        """The ``posterior`` table, if draws were kept."""

    @property
    def manifest(self) -> Any:
        """The manifest: a mapping or a dataclass."""

    @property
    def config_toml(self) -> str:
        """The configuration of the run."""


@dataclass(frozen=True)
class Headline:
    """The summary at the top of the page; empty sentences are omitted."""

    cause: str
    share: str
    stage: str
    undecided: str
    process: str


@dataclass(frozen=True)
class Fact:
    """One line of the provenance or of the population's summary."""

    name: str
    value: str


@dataclass(frozen=True)
class CommittedFile:
    """One table of the run: its name, rows and SHA-256."""

    name: str
    rows: str
    sha256: str


@dataclass(frozen=True)
class RunContent:
    """All content of the page, in its order."""

    run_id: str
    headline: Headline
    total: Yield
    identified: bool
    common: bool
    measurement: Measurement
    clusters: tuple[Clustering, ...]
    lots: tuple[GroupYield, ...]
    wafers: tuple[GroupYield, ...]
    causes: tuple[tuple[str, int], ...]
    pareto: Pareto
    stages: tuple[StageLoss, ...]
    trim: TrimYield | None
    needed: NeededEffects | None
    coverages: tuple[Coverage, ...]
    verdict_check: VerdictCheck | None
    statuses: tuple[StatusCount, ...]
    spreads: tuple[Spread, ...]
    bias_bounds: tuple[BiasBound, ...]
    routes: tuple[RouteDifference, ...]
    worst: tuple[WorstDevice, ...]
    capabilities: tuple[Capability, ...]
    risks: tuple[DecisionRisk, ...]
    risk_curve: RiskCurve | None
    limits: Limits
    population: tuple[Fact, ...]
    provenance: tuple[Fact, ...]
    files: tuple[CommittedFile, ...]
    config_toml: str
    glossary: tuple[Quantity, ...]


def run_content(
    run: ReportedRun,
    limits: Limits,
    population_summary: Mapping[str, Any] | None = None,
    lot_effects: LotEffects | None = None,
    common: Common = MappingProxyType({}),
) -> RunContent:
    """The content of a run's page.

    Parameters
    ----------
    run : tables in the registered schema (absent or null columns are left out of the page), manifest, configuration.
    limits : the limits and rule by which the run was judged.
    population_summary : description of the population, shown unchanged; nested tables become dotted names.

    lot_effects : findings about its misfits, or ``None``.
    common : quantity -> (E, B) shift by one sd of each error that all devices share.

    Raises
    ------
    ConfigError : the limits name a quantity that is not in the results.
    """
    devices = Devices(run.devices)
    _check_limits(devices, limits)
    verdicts = devices.text("verdict")
    given = given_common(devices, run.posterior, limits.rule)
    total = with_common(yield_of_verdicts(verdicts), given)
    bars = pareto(devices, limits)
    stages = stage_losses(devices, limits)
    statuses, identified = status_counts(devices), devices.identified()
    lots, wafers = devices.text("lot"), devices.wafers()
    clusters = tuple(
        clustering_with_common(clustering(verdicts, names, by), names, given)
        for by, names in (("wafer", wafers), ("lot", lots))
        if len(names) and all(names.counts())
    )
    manifest = _mapping(run.manifest)
    calibration, bounds = _by_quantity(devices, limits)
    return RunContent(
        run_id=str(manifest.get("run_id", "")),
        headline=Headline(
            main_cause(total, bars) if identified or not statuses else f"{status_cause(statuses)}",
            cause_sentence(bars),
            stage_sentence(stages),
            undecided_sentence(total, statuses),
            process_sentence(clusters),
        ),
        total=total,
        identified=identified,
        common=given is not None,
        measurement=_measurement(devices, given),
        clusters=clusters,
        lots=groups_with_common(by_group(verdicts, lots), lots, None, given) if any(lots.counts()) else (),
        wafers=_wafer_yields(devices, verdicts, given) if any(wafers.counts()) else (),
        causes=_causes(devices),
        pareto=bars,
        stages=stages,
        needed=needed_effects(devices, lot_effects),
        trim=trim_yield(devices, true_conformity(devices, limits)),
        coverages=calibration,
        verdict_check=_verdict_check(devices, limits, given),
        statuses=statuses,
        spreads=spreads(devices),
        bias_bounds=bounds,
        routes=route_differences(devices),
        worst=worst_devices(devices, limits),
        capabilities=capabilities(devices, limits, common) if identified else (),
        risks=decision_risks(devices, limits, common),
        risk_curve=risk_curve(devices, limits, K_CURVE),
        limits=limits,
        population=facts(population_summary or {}),
        provenance=facts({name: value for name, value in manifest.items() if name not in ("files", "sha256")}),
        files=_files(manifest.get("files", ())),
        config_toml=run.config_toml,
        glossary=QUANTITIES,
    )


def _by_quantity(devices: Devices, limits: Limits) -> tuple[tuple[Coverage, ...], tuple[BiasBound, ...]]:
    """What is said of every quantity, one after the other: a stored column is then read once."""
    pairs = [(coverage(devices, name), bias_bound(devices, limits, name)) for name in NAMES]
    return (
        tuple(row for row, _ in pairs if row is not None),
        tuple(row for _, row in pairs if row is not None),
    )


def _causes(devices: Devices) -> tuple[tuple[str, int], ...]:
    """The known causes with their devices, most frequent first."""
    known = ((cause, number) for cause, number in devices.text("cause").counts().items() if cause)
    return tuple(sorted(known, key=lambda row: (-row[1], row[0])))


def _verdict_check(devices: Devices, limits: Limits, given: GivenCommon | None) -> VerdictCheck | None:
    found = check_verdicts(devices, limits)
    if found is None or given is None:
        return found
    return dataclasses.replace(found, expected_sd=measurement_given_common(given).sd)


def _measurement(devices: Devices, given: GivenCommon | None) -> Measurement:
    if given is None:
        return measurement_uncertainty(devices.number("p_pass"))
    return measurement_given_common(given)


def _wafer_yields(devices: Devices, verdicts: Sequence[str], given: GivenCommon | None) -> tuple[GroupYield, ...]:
    lots, wafers = devices.text("lot"), devices.text("wafer")
    return groups_with_common(by_group(verdicts, lots, wafers), lots, wafers, given)


def facts(table: Mapping[str, Any], prefix: str = "") -> tuple[Fact, ...]:
    """A nested mapping as lines with dotted names; empty and null values are omitted."""
    lines: list[Fact] = []
    for name, value in table.items():
        if isinstance(value, Mapping):
            lines += facts(value, f"{prefix}{name}.")
        elif value is not None and value != "":
            lines.append(Fact(f"{prefix}{name}", _shown(value)))
    return tuple(lines)


def _shown(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_shown(one) for one in value)
    return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)


def _mapping(value: Any) -> Mapping[str, Any]:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return value if isinstance(value, Mapping) else {}


def _files(entries: Any) -> tuple[CommittedFile, ...]:
    # Pages are omitted: this page cannot contain its own hash.
    rows = [_mapping(entry) for entry in entries]
    return tuple(
        CommittedFile(
            str(row.get("name", "")),
            "" if row.get("rows") is None else str(row["rows"]),
            str(row.get("sha256", "")),
        )
        for row in rows
        if row.get("kind") != "page"
    )


def _check_limits(devices: Devices, limits: Limits) -> None:
    absent = [name for name in limits.quantities if name not in devices.table.column_names]
    if absent:
        raise ConfigError(
            "limits on quantities that are not in the results",
            value=absent,
            allowed="columns of the devices table",
            next_step="use the limits of the run",
        )
