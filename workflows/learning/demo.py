"""A virtual device with one effect hidden in it, for the demonstration."""

from __future__ import annotations

import numpy as np

from pipeline.device.model import DEFAULT_COMPARE_MODEL

from ..simulate import Simulated, campaign_config, simulate


def hidden_device(seed: int) -> Simulated:
    """The standard campaign of a random device with a random effect of the library, of a size that a chirp shows."""
    names = sorted(DEFAULT_COMPARE_MODEL.candidates())
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(108,)))
    return simulate(campaign_config(None), {}, [str(random.choice(names))], seed)
