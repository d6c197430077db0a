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

from ....arrays import ComplexArray, FloatArray
from .clipping import Loud, adc_signatures
from .library import FORCES, SHAPE, STAGES, BandSignature, most_signatures
from .linear import LinearDevice, Moved
from .linear_stages import mechanics_coefficients, readout_signatures
from .narrow_band import grid_of
from .nonlinear import drive_forces, forces_of, sense_signatures


@dataclass(frozen=True, eq=False)
class Found:
    """Signatures in a record.

    Parameters
    ----------
    rows : (P + 1 + K, S, 2 W) [V]: of the slopes of the fit, an empty one, and those of the signatures.
    sensed : volts of the device (S, W) [V].
    """

    signatures: tuple[BandSignature, ...]
    rows: FloatArray
    sensed: ComplexArray


def signatures(
    device: LinearDevice,
    moved: Moved,
    loud: Loud,
    sizes: Mapping[str, float],
    with_mismatch: bool,
    slopes: FloatArray,
) -> Found:
    """All signatures of the effects that a fit lacks.

    Parameters
    ----------
    device, moved : at the maximum of the likelihood, in the band of a record (``linear_devices``).
    loud : samples of its volts near their peak (``clipping``).
    sizes : of clipping (:func:`adc_sizes`, :func:`drive_sizes`).
    with_mismatch : whether the fit has electrode mismatches.
    slopes : of the fit, coefficients (P, S, J) of the features.
    """
    grid, count = grid_of(device.band), slopes.shape[0]
    mechanics, of_mechanics = mechanics_coefficients(device, moved, with_mismatch)
    of_motion = device.motion_coefficients
    senses, first, last = SHAPE.senses, count + 1, count + 1 + len(mechanics)
    scratch = -(-of_motion.shape[0] // senses)
    rows = np.empty(
        (max(count + 1 + most_signatures(with_mismatch, STAGES), last + scratch), senses, 2 * device.band.bins.size)
    )
    # One product for all that is linear in the features; the rows of the motion are free again once it is copied.
    parts = (slopes, np.zeros((senses, slopes.shape[2])), of_mechanics, of_motion)
    coefficients = np.concatenate([each.reshape(-1, slopes.shape[2]) for each in parts])
    flat = rows.reshape(-1, rows.shape[2])
    device.rows(coefficients, flat[: coefficients.shape[0]])
    motion = device.motion(flat[senses * last : coefficients.shape[0]])
    signals = device.signals(motion, grid)
    found = [probe.signature(row, 1.0, 1) for probe, row in zip(mechanics, rows[first:])]

    def free() -> FloatArray:
        return rows[first + len(found) :]

    found += adc_signatures(device, loud, sizes, with_mismatch, free())
    found += sense_signatures(device, signals, with_mismatch, free())
    found += readout_signatures(device, motion, grid, with_mismatch, free())
    envelopes = np.zeros((most_signatures(with_mismatch, FORCES), 3, grid.points), dtype=np.complex64)
    forces = list(forces_of(device, signals, with_mismatch, envelopes))
    written = sum(len(one.probes) for one in forces)
    forces += drive_forces(device, signals, sizes, with_mismatch, envelopes[written:])
    own = iter(device.forced(envelopes[: sum(len(one.probes) for one in forces)], grid, free()))
    for one in forces:
        found += [probe.signature(next(own), value, one.order) for probe, value in zip(one.probes, one.values)]
    return Found(tuple(found), rows[: first + len(found)], motion.sensed)
