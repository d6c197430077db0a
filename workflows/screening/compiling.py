"""The loops of a screening run, compiled before its first block: each once, by all local workers together.

Without it every worker compiles every loop: the first run on a machine takes 49 instead of 33 s on 2 cores.

Types of arguments as numba writes them: ``f8[:,::1]`` is a matrix of float64 by rows, ``c8[:]`` a vector of complex64 with any
stride, ``i8`` an int64 and ``b1`` a boolean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module
from typing import Any

from distributed import Client
from numba.core.sigutils import normalize_signature

from pipeline.compiled_loops import is_cached
from pipeline.device.effect import find_effects
from pipeline.device.force_law import compiled_force
from pipeline.experiment.forward.compiled import compiled_first_order, compiled_linear_states
from pipeline.experiment.forward.readout_filter import compiled_filter

from .cluster import local_workers
from .dispatch import in_parallel
from .progress import counted

_SCREENING = "pipeline.inference.screening"
_SCORES = f"{_SCREENING}.undetected"
#: Modules, each with loops that one worker compiles, and the types that a run calls them with.  All types of a loop and of those
#: that it calls are together: the cache may lose one of two entries that are written at once.  Those that take longest are first,
#: so the workers end together.
TYPED_LOOPS: tuple[tuple[str, ...], ...] = (
    (
        f"{_SCREENING}.batch",
        "_log_likelihood(f8[:,::1], f8[:,::1], c16[::1], f8[:,::1], f8[::1], c16[:,:,::1], f8[:,::1], f8[::1])",
        "_log_likelihood(f8[:,::1], f8[:,::1], c16[::1], f4[:,::1], f8[::1], c16[:,:,::1], f8[:,::1], f8[::1])",
    ),
    (
        f"{_SCORES}.force_loops",
        "weighted_sums(f4[:,:,::1], f8[:,:,::1], i8, b1, f8[:,:,::1])",
        "weighted_sums(f4[:,:,::1], f4[:,:,::1], i8, b1, f4[:,:,::1])",
        "first_harmonic(f8[:,:,::1], f8[:,:,::1], f4[:,::1], i8, i8, f4[:,:,::1])",
        "first_harmonic(f4[:,:,::1], f4[:,:,::1], f4[:,::1], i8, i8, f4[:,:,::1])",
    ),
    (
        f"{_SCORES}.scan_bounds",
        "_judge_points(f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[::1], f8[::1], f8[:,::1])",
    ),
    (
        f"{_SCORES}.loops",
        "respond(c8[:,::1], i8[:,::1], i8, f4[:,:,::1], f8[:], f4[:,::1], f8[:,::1], f4[:,:,:,:], f8[:,:,::1])",
    ),
    (
        f"{_SCREENING}.columns",
        "_add_free(c16[::1], c16[:,:,::1], c16[::1], c16[::1], c16[::1], c16[::1], c16[:,::1], c16[:,:,:,::1], "
        "f8, f8[:,:,:,:,:,::1])",
    ),
    (
        "pipeline.identification.poles",
        "_block_arnoldi(f8[:,:,::1], c16, c16[:,::1], i8)",
    ),
    (
        f"{_SCREENING}.convergence",
        "_autocorrelation_times(f8[:,:,::1], f8[:,::1], f8[::1], f8[::1])",
    ),
    (
        f"{_SCREENING}.likelihood",
        "jacobian_rows(f8[::1], c16[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1])",
    ),
    (
        "pipeline.identification.poles",
        "_refine_two(f8[:,:,::1], c16[::1], f8[::1])",
    ),
    (
        f"{_SCREENING}.likelihood",
        "residual_rows(f8[::1], c16[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1])",
        "allowed(f8[::1])",
    ),
    (
        f"{_SCORES}.left",
        "_write_left(f8[:,::1], f8[::1,:], f8[:,::1], i8[:,::1], i8[::1], f8[::1], f8[::1], f8[::1], f8[:,::1], "
        "f8[:,:,::1])",
    ),
    (
        f"{_SCORES}.left",
        "_score(f8[::1], f8[:,::1], f8[:,::1], f8[:,:,::1], i8[:,::1], i8[::1], f8[::1], f8[::1], f8, f8[::1], "
        "f8[::1], f8[::1], f8[:,::1])",
    ),
    (
        "pipeline.identification.arx",
        "_lagged_sums(f8[:,::1], i8, f8[:,:,::1])",
    ),
    (
        f"{_SCORES}.force_loops",
        "loud_points(c8[:,::1], f4, b1[::1])",
        "end_sums(c8[:,:,::1], f4[:,:,:,::1], f4[:,:,:,::1], c8[:,:,:])",
        "sums_of_squares(f4[:,:,::1], f4[:,::1], i8, i8, f8[:,::1])",
        "split_parts(f4[:,::1], i8, i8, f4[:,:,:,::1])",
    ),
    (
        "pipeline.device.gyro",
        "cartesian_modes(f8[::1], c16[::1], c16[:,:,::1])",
    ),
    (
        f"{_SCORES}.loops",
        "in_features(c16[:,:,:,::1], c16[:,:,:,::1], f8, c16[::1], UniTuple(i8, 3), f8[:,:,:,:,:,::1])",
        "read_out(f4[:,:,:,::1], f4[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1])",
        "products_within(f8[:,:,::1], i8, i8[::1], f8[::1], f8[:,::1])",
    ),
    (
        "pipeline.experiment.forward.paths",
        "_between(f8[:,:,::1], i8[::1], f8[:,::1], f8[:,:,::1])",
    ),
    (
        "pipeline.identification.poles",
        "polynomial_at(f8[:,:,::1], c16)",
    ),
    (
        f"{_SCORES}.scan_bounds",
        "_least_above(f8[:,::1], i8[::1], f8[::1], f8[::1], f8[:,::1])",
    ),
    (
        "pipeline.identification.arx",
        "_shift_down(f8[:,::1], i8, f8[:,:,::1], f8[:,::1])",
    ),
    (
        f"{_SCORES}.slopes",
        "_feature_slopes(f8[::1], c16[::1], f8[:,:,::1])",
    ),
    (
        "pipeline.performance.bandwidth_loop",
        "bandwidth(f8[::1], f8[::1], f8[::1], f8[::1])",
    ),
    (
        "pipeline.experiment.forward.linear",
        "_states(f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[:,::1])",
    ),
    (
        f"{_SCORES}.clipping",
        "_clip_value(f8[:,::1], f8[::1], f8, f8)",
    ),
    (
        f"{_SCREENING}.columns",
        "_multiply_filter(c16[:,::1], c16[:,::1])",
    ),
    (
        "pipeline.inference.moments",
        "_moments(f8[:,::1], f8[::1], f8[::1])",
    ),
    (
        f"{_SCREENING}.sample",
        "_walk(f8[::1], f8[:,::1], f8[:,::1], i8[:,::1], i8[::1])",
    ),
)


def typed_loops() -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Each loop of ``TYPED_LOOPS``, with types that it is called with."""
    for module, *calls in TYPED_LOOPS:
        yield from _typed(module, calls)


def needed_loops() -> tuple[Callable[[], object], ...]:
    """Each loads or compiles loops of a run with its examination, or a force of the library."""
    typed = (partial(_compile, *each) for each in TYPED_LOOPS)
    forces = (effect.force for effect in find_effects(()).values())
    return (
        _compile_forward,
        *typed,
        partial(compiled_filter, 4),
        *(partial(compiled_force, force) for force in forces if force is not None),
    )


def is_compiled() -> bool:
    """Whether the cache of this machine holds every loop of ``TYPED_LOOPS``."""
    return all(is_cached(loop, types) for loop, types in typed_loops())


def compile_task(_: None, number: int) -> None:
    """Load or compile number ``number`` of :func:`needed_loops` in a worker."""
    needed_loops()[number]()


def compile_loops(client: Client, quiet: bool) -> None:
    """Compile the loops of a run on the local workers of ``client``, where the cache of this machine does not hold them.

    Raises
    ------
    IncompleteError : as ``dispatch.in_parallel``.
    """
    # The caches of other machines are not known.
    if local_workers(client) is None or is_compiled():
        return
    numbers = range(len(needed_loops()))
    with counted(len(numbers), quiet, "compiling the numerical code, once on this machine") as done:
        for _ in in_parallel(client, compile_task, None, numbers):
            done()


def _typed(module: str, calls: Sequence[str]) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    for call in calls:
        name, types = call.removesuffix(")").split("(", maxsplit=1)
        arguments, _ = normalize_signature(f"({types},)")
        yield getattr(import_module(module), name), arguments


def _compile(module: str, *calls: str) -> None:
    for loop, types in _typed(module, calls):
        loop.compile(types)


def _compile_forward() -> None:
    compiled_first_order(4, 0)
    compiled_linear_states(4)
