"""The losses of a population to the limits of a run: true quantities of virtual devices against limits.

Every device is one draw of the whole hierarchy, on a wafer of its own (``populations.latent``).  What is estimated is the loss of
the process: the share of devices whose true quantities, as packaged, are beyond a limit.  Nothing is identified.

Shapes: B devices, d latent normals, S sides of limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.errors import ConfigError
from populations.latent import draw_latent, latent_space
from reports.limits import Limit
from reports.rare import Driver, RareLosses, driver_of

from ..config import RunConfig
from ..config_tables import SamplingTable
from ..screening.block import true_quantities
from ..screening.settings import population
from .estimate import LimitProblem, Losses, least_devices, plain_losses, rare_losses

#: Random stream of the sampling.
_STREAM = 131
#: Latent normals that are named for a loss, and the excess of their mean square from which they are.
_DRIVERS, _EXCESS = 4, 0.5


@dataclass(frozen=True, eq=False)
class LimitStates:
    """The limits towards which a run samples: the problem, and the names of the latent normals (d,)."""

    problem: LimitProblem
    names: tuple[str, ...]


def sampling_of(config: RunConfig) -> SamplingTable:
    """[sampling] of the run, or its defaults."""
    return config.sampling or SamplingTable()


def limit_states(config: RunConfig) -> LimitStates:
    """The problem that [sampling] of a run states.

    Raises
    ------
    ConfigError : the run has no population; too few devices for so many limits; the population cannot be read.
    """
    if config.source.kind != "population":
        raise ConfigError(
            "rare losses are those of a population",
            value=config.source.kind,
            allowed='source.kind = "population"',
            next_step="state the population in [source]",
        )
    table = sampling_of(config)
    limits = [limit for limit in config.judged_by().limits if not table.limits or limit.quantity in table.limits]
    sides = _sides(limits)
    least = least_devices(sum(len(columns) for columns in sides.values())) if table.method == "importance" else 1
    if table.devices < least:
        raise ConfigError(
            "sampling.devices is too small for these limits",
            value=table.devices,
            allowed=f"at least {least}",
            next_step="raise it, or name fewer limits in [sampling] limits",
        )
    spec = population(config)
    space, gain = latent_space(spec), float(spec.angular_gain)

    def responses(z: FloatArray) -> FloatArray:
        with threadpool_limits(limits=1):
            drawn = draw_latent(spec, space, z, config.run.seed)
            values = true_quantities(config, drawn.true, gain)
            return np.stack([side for limit in limits for side in limit.beyond(values[limit.quantity])], axis=1)

    return LimitStates(LimitProblem(space.dimension, responses, sides), space.names)


def _sides(limits: list[Limit]) -> dict[str, tuple[int, ...]]:
    """Columns of the responses for each limit."""
    out: dict[str, tuple[int, ...]] = {}
    first = 0
    for limit in limits:
        count = len(limit.beyond(np.zeros(1)))
        out[limit.quantity] = tuple(range(first, first + count))
        first += count
    return out


def estimated_losses(config: RunConfig) -> RareLosses:
    """The losses that [sampling] of a run asks for; raises as :func:`limit_states`.

    The result depends on the configuration and its seed only.
    """
    states, table = limit_states(config), sampling_of(config)
    random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM,)))
    method = rare_losses if table.method == "importance" else plain_losses
    found = method(states.problem, table.devices, table.precision, random)
    drivers = {loss.limit: _drivers(found, states.problem.sides.get(loss.limit), states.names) for loss in found.losses}
    return RareLosses(found.losses, drivers, table.method, found.devices, config.run.seed, len(states.names))


def _drivers(found: Losses, sides: tuple[int, ...] | None, names: tuple[str, ...]) -> tuple[Driver, ...]:
    """The latent normals that differ most between lost devices and the population; ``None``: of all sides."""
    beyond = found.beyond if sides is None else found.beyond[:, list(sides)]
    lost = np.any(beyond, axis=1)
    if not np.any(lost):
        return ()
    weight = found.weight[lost] / np.sum(found.weight[lost])
    z = found.z[lost]
    drivers = [driver_of(name, weight, z[:, k]) for k, name in enumerate(names)]
    drivers = [one for one in drivers if one.rms**2 - 1.0 > _EXCESS]
    return tuple(sorted(drivers, key=lambda one: -one.rms)[:_DRIVERS])


def with_sampling(config: RunConfig, changes: Mapping[str, object]) -> RunConfig:
    """``config`` with other values of [sampling]."""
    return msgspec.structs.replace(config, sampling=msgspec.structs.replace(sampling_of(config), **changes))
