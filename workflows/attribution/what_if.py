"""What if a spread, a mean or a bow of the population were another one?

    the stored devices drawn again with their own numbers (true values, any change)
    the stored devices weighted (verdicts too; spreads that become smaller)

Shapes: N devices, d numbers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import ConfigError, UsageError
from pipeline.store.columns import StoredTable
from pipeline.toml_files import check_known
from populations.latent import latent_space
from populations.spec import PopulationSpec
from populations.spreads import spread_numbers
from populations.stored import DIE, draw_stored, number_names
from reports.attribution.content import ChangedLoss
from reports.attribution.reweighting import LEAST_LOTS_WITH_LOSS, log_weights, paired_share, reweighted_share
from reports.decision import conforms
from reports.devices import Devices
from reports.words.attribution import refused

from ..config import RunConfig
from ..screening.block import true_quantities
from ..screening.settings import population
from .shares import MOST_STORED, require_population
from .stored import StoredRunNumbers, stored_numbers

#: Devices that are drawn again together: 20 kB each.
_BATCH = 5000
_CHANGE = re.compile(r"\s*([A-Za-z0-9_.]+)\s*([*=])\s*([-+0-9.eE]+)\s*")


def parsed_changes(spec: PopulationSpec, text: str) -> dict[str, tuple[float, float]]:
    """Parameter -> (value, new value) of "spring_width.wafer_um*0.5, lid_leak.fraction=0.01".

    Raises
    ------
    UsageError : not of that form.
    ConfigError : a parameter that the population does not have.
    """
    found: dict[str, tuple[float, float]] = {}
    values = {
        f"{irregularity.name}.{name}": value for irregularity, given in spec.found() for name, value in given.items()
    }
    for part in text.split(","):
        match = _CHANGE.fullmatch(part)
        number = _number(match[3]) if match else None
        if match is None or number is None:
            raise UsageError(
                "--what-if does not state a change",
                value=part.strip(),
                allowed='PARAMETER*FACTOR or PARAMETER=VALUE, separated by commas: "spring_width.wafer_um*0.5"',
                next_step="correct it",
            )
        check_known(match[1], values, "--what-if", "parameter")
        before = found.get(match[1], (values[match[1]],) * 2)
        found[match[1]] = (before[0], before[1] * number if match[2] == "*" else number)
    return found


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def what_if(config: RunConfig, folder: Path, devices: StoredTable, text: str) -> ChangedLoss:
    """The share of lost devices of a run if its population were changed as ``text`` says.

    Raises
    ------
    UsageError : measured campaigns; not a change; the run has no devices or stored no irregularities.
    ConfigError : a value out of its range; a population that the stored numbers do not belong to.
    """
    require_population(config)
    spec = population(config)
    changes = parsed_changes(spec, text)
    changed = spec.with_values({name: new for name, (_, new) in changes.items()})
    columns = Devices(devices)
    found = stored_numbers(folder, columns, MOST_STORED)
    if found is None:
        raise UsageError(
            "the run stored no irregularities",
            value=folder.name,
            allowed="a run with devices and source.store_irregularities = true",
            next_step="run it again; runs of earlier versions stored none",
        )
    if found.keys != tuple((n.irregularity, n.level, n.label, n.component) for n in number_names(spec)):
        raise ConfigError(
            "the irregularities read other random numbers now than in the run",
            value=folder.name,
            next_step="use the version of gyroscreen, and of your irregularities, that the run was made with",
        )
    before, after = (_lost(config, spec, one, found) for one in (spec, changed))
    log_w, refusal = _weights(spec, changes, found)
    outcomes = {"truth": before, "verdict": (~columns.has("pass"))[found.rows]}
    weighted = None
    if log_w is not None:
        weighted = {name: reweighted_share(y.astype(float), found.lot, log_w) for name, y in outcomes.items()}
        lots = min(one.lots_with_loss for one in weighted.values())
        if lots < LEAST_LOTS_WITH_LOSS:
            weighted, refusal = None, refused("few_lots", f"{lots:.1f}")
    return ChangedLoss(
        changes,
        len(found.lot),
        int(np.unique(found.lot).size),
        paired_share(before.astype(float), after.astype(float), found.lot),
        weighted,
        refusal,
    )


def _lost(config: RunConfig, spec: PopulationSpec, other: PopulationSpec, found: StoredRunNumbers) -> BoolArray:
    """(N,) whether the stored devices are truly lost under the population ``other``."""
    lost, limits = np.zeros(len(found.index), dtype=np.bool_), config.judged_by()
    for first in range(0, lost.size, _BATCH):
        rows = slice(first, first + _BATCH)
        drawn = draw_stored(spec, other, found.index[rows], found.values[rows], config.run.seed)
        lost[rows] = ~conforms(limits, true_quantities(config, drawn.true, float(other.angular_gain)))
    return lost


def _weights(
    spec: PopulationSpec, changes: Mapping[str, tuple[float, float]], found: StoredRunNumbers
) -> tuple[FloatArray | None, str]:
    """ln of the weights (N,), or ``None`` and the reason why there are none."""
    space = latent_space(spec)
    factor = np.ones(space.dimension)
    for name, (old, new) in changes.items():
        entries = spread_numbers(spec, *name.split(".", 1))
        if entries is None:
            return None, refused("no_spread", name)
        factor[entries] *= new / old
    factor = factor[np.arange(space.dimension) != space.first[DIE]]
    if np.any(factor <= 0.0) or np.any(factor > 1.0):
        return None, refused("wider", ", ".join(changes))
    total = np.zeros(len(found.lot))
    for k in np.flatnonzero(factor != 1.0):
        total += log_weights(found.values[:, [k]], float(factor[k]))
    return total, ""
