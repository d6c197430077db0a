"""gyroscreen benchmark sequential, lattice."""

from __future__ import annotations

import time

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.identification.lattice import advance, arx_of, start_lattice

from ..studies.sequential import figures, run_sequential_study
from .benchmark import show

_RATE_HZ = 10_000.0
_BLOCK = 500


def sequential(devices: int, near: int, seed: int, workers: int, json: bool) -> None:
    """See ``gyroscreen benchmark sequential --help``."""
    show(figures(run_sequential_study(devices, near, seed, workers)), json)


def lattice(order: int, seconds: float, json: bool) -> None:
    """See ``gyroscreen benchmark lattice --help``; two drives and two senses."""
    random = np.random.default_rng(1)
    blocks = max(2, round(seconds * _RATE_HZ / _BLOCK))
    y, u = random.standard_normal((2, blocks * _BLOCK, 2))
    state = advance(start_lattice(2, 2, order, np.full(4, 1e-8)), y[:_BLOCK], u[:_BLOCK])  # compiles before the timing
    with threadpool_limits(limits=1):
        wall, cpu = time.perf_counter(), time.process_time()
        for k in range(1, blocks):
            state = advance(state, y[k * _BLOCK : (k + 1) * _BLOCK], u[k * _BLOCK : (k + 1) * _BLOCK])
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        start = time.perf_counter()
        arx_of(state)
        solved = time.perf_counter() - start
    samples = (blocks - 1) * _BLOCK
    show(
        {
            "order": order,
            "samples": samples,
            "samples/s of CPU time": samples / cpu,
            "real-time factor at 10 kHz, CPU time": samples / cpu / _RATE_HZ,
            "real-time factor at 10 kHz, wall time": samples / wall / _RATE_HZ,
            "ARX coefficients from the lattice, s": solved,
        },
        json,
    )
