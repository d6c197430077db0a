"""The band of the likelihood against the drive and the modes, before the first device.

    band     low_hz .. high_hz of [identification]
    drive k  what start_hz, stop_hz and amplitude_v of [experiment] sweep

The check refuses only a run in which no device can be identified: a drive that is silent or never enters the band, and modes that
lie outside it on every drawn device.  A drive that ends below a mode still excites it (the ends of a chirp are broad), so modes
are compared with the band alone.
"""

from __future__ import annotations

import numpy as np

from pipeline.errors import ConfigError
from populations.draw import draw

from ..config import RunConfig
from .settings import population

#: With all of so many devices outside the band, at most one device in seven is inside it (95 %).
_DEVICES = 20
_MODES = ("f1_hz", "f2_hz", "f3_hz")


def check_band(config: RunConfig) -> None:
    """Check that the drives of virtual devices enter the band, and that their modes lie in it.

    Raises
    ------
    ConfigError : a drive is silent or does not enter the band, or no drawn device has all of its modes inside.
    """
    low, high = config.identification.low_hz, config.identification.high_hz
    volts = config.experiment.amplitude_v
    if not all(volts):
        raise ConfigError(
            f"experiment: drive {volts.index(0.0) + 1} is silent, and one drive alone does not identify a gyro",
            value=list(volts),
            allowed="amplitude_v above 0 for every drive",
            next_step="correct amplitude_v",
        )
    for k, (first, last) in enumerate(driven_hz(config)):
        if last <= low or first >= high:
            raise ConfigError(
                f"experiment: drive {k + 1} does not enter the band of the identification",
                value=[first, last],
                allowed=f"a sweep that enters {low:g} to {high:g} Hz (identification.low_hz, high_hz)",
                next_step="correct start_hz and stop_hz, or the band",
            )
    spec = population(config)
    true = draw(spec, config.run.seed, 0, min(_DEVICES, config.run.devices)).true
    modes = np.stack([true[name] for name in _MODES])
    if not np.any(np.all((low < modes) & (modes < high), axis=0)):
        raise ConfigError(
            "identification: the band does not contain the three modes of any device that the population draws",
            value=[low, high],
            allowed=f"low_hz below {modes.min():.1f} and high_hz above {modes.max():.1f} Hz",
            next_step="correct low_hz and high_hz, or the population",
        )


def driven_hz(config: RunConfig) -> list[tuple[float, float]]:
    """Lowest and highest frequency [Hz] of each drive."""
    e = config.experiment
    sweeps = [(min(pair), max(pair)) for pair in zip(e.start_hz, e.stop_hz, strict=True)]
    if e.kind == "multisine":
        sweeps = [(min(low for low, _ in sweeps), max(high for _, high in sweeps))] * len(sweeps)
    return sweeps
