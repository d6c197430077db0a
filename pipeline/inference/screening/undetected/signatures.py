"""Signatures of the effects of the library in the band of a device, by stage of the signal path, without simulation.

| stage              | change of the record in the band |
|---|---|
| drive, force       | response to the first harmonic of the force (``narrow_band``) |
| mechanics          | change of poles and residues |
| sense              | first harmonic of the change of the pick-off volts, through the filter |
| readout            | change of G(i w) S + G(i w)(R + i w C) v |
| adc                | transform of the change of the model's volts |

Shapes: S = 2 senses, W bins, N samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ....arrays import FloatArray
from .clipping import Loud, adc_signatures
from .library import SHAPE, BandSignature, most_signatures
from .linear import LinearDevice, Moved
from .linear_stages import mechanics_signatures, readout_signatures
from .narrow_band import grid_of
from .nonlinear import drive_forces, forces_of, sense_signatures


@dataclass(frozen=True, eq=False)
class Found:
    """Signatures in a record, and the array of their rows (head + K, S, 2 W) [V], which begins with ``head`` rows of the fit."""

    signatures: tuple[BandSignature, ...]
    rows: FloatArray


def signatures(
    device: LinearDevice, moved: Moved, loud: Loud, sizes: Mapping[str, float], with_mismatch: bool, head: int = 0
) -> Found:
    """All signatures of the effects that a fit lacks.

    Parameters
    ----------
    device, moved : at the maximum of the likelihood, in the band of a record (``linear_devices``).
    loud : samples of its volts near their peak (``clipping``).
    sizes : of clipping (:func:`adc_sizes`, :func:`drive_sizes`).
    with_mismatch : whether the fit has electrode mismatches.
    head : rows before those of the signatures, which are left empty for the fit.
    """
    grid = grid_of(device.band)
    signals = device.signals(grid)
    rows = np.empty((head + most_signatures(with_mismatch), SHAPE.senses, 2 * device.band.bins.size))
    found: list[BandSignature] = []

    def free() -> FloatArray:
        return rows[head + len(found) :]

    found += adc_signatures(device, loud, sizes, with_mismatch, free())
    found += sense_signatures(device, signals, with_mismatch, free())
    found += mechanics_signatures(device, moved, with_mismatch, free())
    found += readout_signatures(device, grid, with_mismatch, free())
    forces = [*forces_of(device, signals, with_mismatch), *drive_forces(device, signals, sizes, with_mismatch)]
    if forces:
        ends = np.cumsum([0, *(len(one.probes) for one in forces)])
        envelopes = np.zeros((ends[-1], 3, grid.points), dtype=np.complex64)
        for first, last, one in zip(ends, ends[1:], forces):
            envelopes[first:last, :, one.points] = one.envelopes
        own = iter(device.forced(envelopes, grid, free()))
        for one in forces:
            found += [probe.signature(next(own), value, one.order) for probe, value in zip(one.probes, one.values)]
    return Found(tuple(found), rows[: head + len(found)])
