"""The loops that almost every search for an effect needs: whether they are compiled, and how each is made ready before it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ...device.effect import find_effects
from ...device.force_law import compiled_force
from .compiled import compiled_deviation, compiled_first_order, compiled_linear_states, deviation_is_cached
from .readout_filter import compiled_filter

#: Places for coordinates: those of a gyro with at most one more.
_SIZE = 4
#: Pairs of poles of the anti-alias filter of order 8.
_LANES = 4
#: Places for coordinates that a force law appends: none, and hidden modes or memories of two axes.
_BESIDE = (0, 2)


def is_compiled() -> bool:
    """Whether the cache of this machine holds the largest of the loops."""
    return deviation_is_cached(_SIZE)


def needed_loops() -> tuple[Callable[[], object], ...]:
    """Each loads or compiles a loop, in the order of their need, and then a force of the library."""
    size, (none, some) = _SIZE, _BESIDE
    loops = (
        partial(compiled_deviation, size),
        partial(compiled_first_order, size, none),
        partial(compiled_filter, _LANES),
        partial(compiled_linear_states, size),
        partial(compiled_first_order, size, some),
    )
    # From the last: a search that has come so far begins with the first.
    forces = (effect.force for effect in reversed(find_effects(()).values()))
    return (*loops, *(partial(compiled_force, force) for force in forces if force is not None))


def compile_loops() -> None:
    """Compile the needed loops, and those that only fits with appended coordinates need."""
    for make in needed_loops():
        make()
    compiled_deviation(_SIZE, _BESIDE[1])
