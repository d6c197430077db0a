"""The loops that almost every search for an effect needs: whether they are compiled, and their compilation before it."""

from __future__ import annotations

from pathlib import Path

from numba import njit

from ...device.effect import find_effects
from ...device.force_law import compiled_force
from .compiled import compiled_deviation, compiled_first_order, compiled_linear_states
from .kernels import deviation_from_linear
from .readout_filter import compiled_filter

#: Places for coordinates: those of a gyro with at most one more, and with two more or with memories.
_SIZES = (4, 6)
#: Pairs of poles of the anti-alias filter of order 8.
_LANES = 4
#: Places for coordinates that a force law appends: none, and hidden modes or memories of two axes.
_BESIDE = (0, 2)


def is_compiled() -> bool:
    """Whether the cache of this machine holds the largest of the loops, compiled after its source was written."""
    source = Path(deviation_from_linear.__code__.co_filename)
    cache = Path(njit(cache=True)(deviation_from_linear).stats.cache_path or source.parent)
    written = [file.stat().st_mtime for file in cache.glob(f"{source.stem}.{deviation_from_linear.__name__}-*.nbi")]
    return max(written, default=0.0) > source.stat().st_mtime


def compile_loops() -> None:
    """Compile the loops in the order of their need, and the forces of the library; what is cached is loaded."""
    compiled_deviation(_SIZES[0])
    compiled_first_order(_SIZES[0], _BESIDE[0])
    compiled_filter(_LANES)
    compiled_linear_states(_SIZES[0])
    compiled_first_order(_SIZES[0], _BESIDE[1])
    # From the last: a search that has come so far begins with the first.
    for effect in reversed(find_effects(()).values()):
        if effect.force is not None:
            compiled_force(effect.force)
    # Only fits with such effects need more places.
    compiled_deviation(_SIZES[1])
