"""What a run configuration implies: a quick draw of its population, judged by its limits, without records."""

from __future__ import annotations

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.errors import ConfigError
from populations.draw import Draw, draw
from populations.latent import draw_latent, latent_space
from populations.spec import PopulationSpec
from reports.preview import Preview, preview_of

from ..config import RunConfig
from .block import true_quantities
from .settings import population

#: Drawn devices: the half-width of the interval of a yield of 50 % is then 1.6 %, and the draw takes 0.04 s.
DEVICES = 4000
#: Devices of a population that cannot be drawn so: those of the run, a few lots.
PLAIN_DEVICES = 200
_STREAM = 109


def preview(config: RunConfig) -> Preview | None:
    """The preview of a run; ``None`` for measured campaigns.

    The devices are independent draws of the whole hierarchy, from random numbers of their own, where that is possible.

    Raises
    ------
    ConfigError : the population contains a device that cannot be.
    """
    if config.source.kind != "population":
        return None
    spec = population(config)
    with threadpool_limits(limits=1):
        try:
            drawn, lots = _independent(config, spec)
        except ConfigError:
            # An irregularity that reads other numbers for some devices has no latent normals; a faulty one fails here as well.
            drawn = draw(spec, config.run.seed, 0, PLAIN_DEVICES)
            lots = drawn.lot
        bare = draw(msgspec.structs.replace(spec, irregularity={}), config.run.seed, 0, 1)
    gain = float(spec.angular_gain)
    true, nominal = (true_quantities(config, one.true, gain) for one in (drawn, bare))
    return preview_of(true, nominal, config.judged_by(), lots)


def _independent(config: RunConfig, spec: PopulationSpec) -> tuple[Draw, tuple[str, ...]]:
    """Devices each of a lot of its own, and these lots."""
    space = latent_space(spec)
    random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM,)))
    drawn = draw_latent(spec, space, random.standard_normal((DEVICES, space.dimension)), config.run.seed)
    return drawn, tuple(map(str, range(DEVICES)))
