"""Study of the efficiency of the estimates of theta and split, for given splits and signal-to-noise ratios.

    z = (estimate - truth) / sd_CRLB,    efficiency figure = rms z, 1 at the Cramer-Rao bound

The bound is that of white noise of the instrument and the ADC with all fitted parameters free (``coverage.bounds_of``).  The
devices are those of the default population, each with the split of its cell; only the fit is made, hardly any posterior.

    DIR/<SNR>dB-<split>Hz.jsonl    one JSON object per block of devices; an interrupted study continues there

A row depends on (seed, cell, number) only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.special import chdtri
from threadpoolctl import threadpool_limits

from pipeline.axial import difference
from pipeline.device.gyro import split_hz, to_physical
from pipeline.inference.screening.result import Fitted
from populations.draw import Draw, draw

from ..config import RunConfig, load_config
from ..config_bench import NoiseTable
from ..screening.settings import population
from ..screening.virtual_device import fit_virtual, physical_of
from .coverage import Share, bounds_of, with_splits
from .rows_by_kind import add_rows

#: Signal-to-noise ratios [dB] and splits [Hz] of the cells.
SNR_DB, SPLITS_HZ = (40.0, 60.0, 80.0), (0.1, 0.3, 1.0, 3.0, 10.0)
CELLS: Mapping[str, tuple[float, float]] = {
    f"{snr:g}dB-{split:g}Hz": (snr, split) for snr in SNR_DB for split in SPLITS_HZ
}
#: Devices of a row.
BLOCK = 50
_STREAM = 131


def cell_config(seed: int, cell: str) -> RunConfig:
    """The default run at the noise of a cell, with a posterior of a few draws."""
    stream = np.random.SeedSequence(seed, spawn_key=(_STREAM, list(CELLS).index(cell)))
    config = load_config(None, {"seed": int(stream.generate_state(1)[0] >> 1)})
    posterior = msgspec.structs.replace(config.posterior, walkers=32, steps=4, stored_draws=0)
    return msgspec.structs.replace(config, noise=NoiseTable(snr_db=CELLS[cell][0]), posterior=posterior)


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of block ``item`` = (cell, number), computed on a worker: z of theta and of split of every fitted device."""
    cell, number = item
    config = cell_config(seed, cell)
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = with_splits(draw(spec, config.run.seed, number * BLOCK, BLOCK), np.full(BLOCK, CELLS[cell][1]))
        found = [_errors(config, drawn, i, float(spec.angular_gain)) for i in range(BLOCK)]
    good = [one for one in found if one is not None]
    return {
        "kind": cell,
        "number": number,
        "seed": seed,
        "failed": "",
        "not_fitted": BLOCK - len(good),
        "z_theta": [round(theta, 4) for theta, _ in good],
        "z_split": [round(split, 4) for _, split in good],
    }


def _errors(config: RunConfig, drawn: Draw, i: int, angular_gain: float) -> tuple[float, float] | None:
    fitted = fit_virtual(config, drawn, i, angular_gain)
    if not isinstance(fitted, Fitted):
        return None
    x = fitted.scoring.fit.x[None, :12]
    physical = physical_of(drawn.true)[i]
    sd_theta, sd_split = bounds_of(config, drawn, i)
    theta = float(difference(to_physical(x)[0, 6], physical[6])) / sd_theta
    return theta, (float(split_hz(x)[0]) - float(drawn.true["split_hz"][i])) / sd_split


def run_study(cells: Sequence[str], devices: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows of ``devices`` devices per cell to the files in ``folder``; yields (rows done, rows in all).

    Raises
    ------
    UsageError : an unknown cell, or the folder cannot be written.
    """
    return add_rows(study_row, CELLS, cells, math.ceil(devices / BLOCK), seed, folder, workers)


def rms_with_interval(z: Sequence[float]) -> str:
    """rms z with its 95 % interval for normal errors, from the quantiles of chi2."""
    n = len(z)
    if not n:
        return "none"
    value = math.sqrt(sum(one * one for one in z) / n)
    low, high = (value * math.sqrt(n / float(chdtri(n, tail))) for tail in (0.025, 0.975))
    return f"{value:.3f} ({low:.3f} to {high:.3f})"


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Share | str]:
    """rms z of theta and of split of each cell, and the share of devices that were not fitted."""
    found: dict[str, Share | str] = {}
    for cell in CELLS:
        own = [row for row in rows if row["kind"] == cell]
        if not own:
            continue
        for name in ("theta", "split"):
            z = [one for row in own for one in row[f"z_{name}"]]
            found[f"{cell.replace('-', ', ')}: rms ({name} - truth)/CRLB"] = rms_with_interval(z)
        found[f"{cell.replace('-', ', ')}: not fitted"] = Share(sum(row["not_fitted"] for row in own), BLOCK * len(own))
    return found
