"""Where the loss of a run comes from: the shares of its population, and those of its stored devices.

population -> devices whose numbers are exchanged group by group -> true loss and quantities -> Shapley shares
stored numbers, verdicts, estimates ---------------------------------------------------------> shares without a model

Shapes: N devices, d numbers, q outputs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import UsageError
from pipeline.quantities import AXES
from pipeline.store.columns import StoredTable
from populations.drawn import UNIFORM
from populations.latent import latent_space, true_latent
from reports.attribution.content import (
    FIELD,
    LOSS,
    PLACE,
    Attribution,
    OutputShares,
    Source,
    StoredShares,
    output_shares,
    with_halved,
)
from reports.attribution.given_data import given_data_shares
from reports.attribution.shapley import halved_change, shapley_shares
from reports.attribution.verdicts import explained_verdicts
from reports.decision import conforms_each
from reports.devices import Devices

from ..config import RunConfig
from ..screening.block import true_quantities
from ..screening.settings import population
from .stored import StoredRunNumbers, stored_numbers

#: Samples: the largest share of the default population is then known to +-0.02 (sd 0.01).
SAMPLES = 10_000
#: Devices that attribution from stored ones uses: 500 lots of the default population, 3 s of processor time.
MOST_STORED = 100_000
_STREAM = 111


def source_of(irregularity: str, level: str, label: str) -> Source:
    """The source that a number belongs to; a random field varies within its wafer and is a level of its own."""
    return Source(irregularity, FIELD if (level, label) == ("wafer", "field") else level)


def attribution(config: RunConfig, folder: Path, devices: StoredTable, samples: int = SAMPLES) -> Attribution:
    """Where the loss comes from in a run: by its population and limits, its verdicts and its stored devices.

    Raises
    ------
    UsageError : the run has measured campaigns, whose irregularities nobody knows.
    ConfigError : a sampled device has no positive stiffness.
    """
    columns = Devices(devices)
    stored = _stored_shares(config, columns, stored_numbers(folder, columns, MOST_STORED))
    return replace(process_attribution(config, devices, samples), stored=stored)


def process_attribution(config: RunConfig, devices: StoredTable, samples: int) -> Attribution:
    """The same without the stored devices; raises as :func:`attribution`."""
    require_population(config)
    columns = Devices(devices)
    limits = config.judged_by()
    truth = {q: columns.number(f"true_{q}") for q in limits.quantities}
    lost = ~np.logical_and.reduce(list(conforms_each(limits, truth).values()))
    lots = columns.text("lot").codes
    return Attribution(
        samples,
        process_shares(config, samples),
        explained_verdicts(lost, ~columns.has("pass"), lots) if len(columns) else None,
    )


def require_population(config: RunConfig) -> None:
    """Raise UsageError unless the devices of a run were drawn from a population."""
    if config.source.kind != "population":
        raise UsageError(
            "the devices of the run were measured, so that their irregularities are unknown",
            value=config.source.kind,
            allowed='a run with [source] kind = "population"',
            next_step="name another run",
        )


def process_shares(config: RunConfig, samples: int) -> tuple[OutputShares, ...]:
    """Shares of the population in the true loss, in the loss to each limit, and in the variance of each limited quantity."""
    spec, limits = population(config), config.judged_by()
    space = latent_space(spec)
    streams = [(stream, size) for stream, size in space.size.items()]
    named = [
        Source("", PLACE) if stream == "wafer/die" else source_of(*_split(stream))
        for stream, size in streams
        for _ in range(size)
    ]
    sources = list(dict.fromkeys(named))
    group = np.array([sources.index(one) for one in named], dtype=np.int64)
    quantities = [q for q in limits.quantities if q not in AXES]

    def evaluate(z: FloatArray) -> FloatArray:
        drawn = true_latent(spec, space, z, config.run.seed)
        true = true_quantities(config, drawn, float(spec.angular_gain), limits.quantities)
        met = conforms_each(limits, true)
        lost = [~np.logical_and.reduce(list(met.values())), *(~met[q] for q in limits.quantities)]
        return np.stack([*lost, *(true[q] for q in quantities)], axis=1).astype(np.float64)

    random = np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM,))
    seed = int(random.generate_state(1, np.uint64)[0])
    outputs = [LOSS, *(f"{LOSS}:{q}" for q in limits.quantities), *quantities]
    loss, *others = output_shares(outputs, sources, shapley_shares(evaluate, group, samples, seed))

    x = np.random.Generator(np.random.PCG64(random.spawn(1)[0])).standard_normal((samples, space.dimension))
    at_x = evaluate(x)[:, 0]
    # Half of a uniform number, or of the place, is no smaller spread.
    uniform = {named[space.first[stream]] for stream, _ in streams if stream.endswith(UNIFORM)}
    normal = [k for k, one in enumerate(sources) if one.level != PLACE and one not in uniform]
    halved = {sources[k]: halved_change(evaluate, group, k, x, at_x) for k in normal}
    return with_halved(loss, halved), *others


def _split(stream: str) -> tuple[str, str, str]:
    irregularity, level, label = stream.split("/", 2)
    return irregularity, level, label


def _stored_shares(config: RunConfig, columns: Devices, found: StoredRunNumbers | None) -> StoredShares:
    if found is None:
        return StoredShares(0, 0, (), "the run stored no irregularities (source.store_irregularities)")
    lots = int(np.unique(found.lot).size)
    named = [source_of(*key[:3]) for key in found.keys] + [Source("", PLACE)] * 3
    sources = list(dict.fromkeys(named))
    group = np.array([sources.index(one) for one in named], dtype=np.int64)
    z = np.concatenate([found.values, _place(found)], axis=1)
    names = [q for q in config.judged_by().quantities if q not in AXES]
    values = {LOSS: (~columns.has("pass"))[found.rows].astype(np.float64)}
    values |= {q: columns.number(q)[found.rows] for q in names}
    outputs: list[OutputShares] = []
    for name, y in values.items():
        known = np.isfinite(y)
        try:
            shares = given_data_shares(z[known], group, _renumbered(found.lot[known]), y[known][:, None])
        except UsageError as error:
            return StoredShares(len(found.lot), lots, (), str(error))
        outputs += output_shares([name], sources, shares, rest=True)
    return StoredShares(len(found.lot), lots, tuple(outputs))


def _renumbered(lot: IntArray) -> IntArray:
    return np.asarray(np.unique(lot, return_inverse=True)[1], dtype=np.int64)


def _place(found: StoredRunNumbers) -> FloatArray:
    """x, y and x^2 + y^2 (N, 3) of the dies, each with mean 0 and variance 1: what a bow or a wedge acts on."""
    x, y = found.die_x_mm, found.die_y_mm
    raw = np.stack([x, y, x * x + y * y], axis=1)
    spread = raw.std(axis=0)
    return np.asarray((raw - raw.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0))
