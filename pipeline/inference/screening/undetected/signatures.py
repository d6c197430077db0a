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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....arrays import FloatArray
from .clipping import Loud, adc_changes
from .forces import forces_of
from .library import SHAPE, STAGES, Acting, BandSignature, Changed, most_signatures, write_real
from .linear import BandMotion, DeviceForces, LinearDevice, Moved
from .linear_stages import mechanics_coefficients, readout_signatures, time_changes
from .narrow_band import Signals, grid_of
from .nonlinear import sense_changes


@dataclass(frozen=True, eq=False)
class Found:
    """Signatures in a record.

    Parameters
    ----------
    acting : the K parameters whose changes the last rows are.
    rows : (P + 1 + K, S, 2 W) [V]: of the slopes of the fit, an empty one, and those of the signatures.
    sensed : volts of the device (S, 2 W) [V], real parts before imaginary ones.
    """

    acting: tuple[Acting, ...]
    rows: FloatArray
    sensed: FloatArray

    @property
    def signatures(self) -> list[BandSignature]:
        """The signatures per unit of their strengths."""
        return [one.signature(row) for one, row in zip(self.acting, self.rows[-len(self.acting) :])]


#: The motion of a device in the band, and its envelopes.
Motion = tuple[BandMotion, Signals]


@dataclass(frozen=True, eq=False)
class Along:
    """The motion of a device in the band, its envelopes, the forces along it, and what other laws change along it."""

    motion: BandMotion
    signals: Signals
    forces: DeviceForces
    changed: tuple[Changed, ...]


def band_motion(device: LinearDevice) -> Motion:
    """The motion of a device in its band."""
    motion = device.motion(device.rows(device.motion_coefficients))
    return motion, device.signals(motion, grid_of(device.band))


def along_motions(
    devices: Sequence[LinearDevice],
    motions: Sequence[Motion],
    louds: Sequence[Loud],
    sizes: Sequence[Mapping[str, float]],
    with_mismatch: bool,
) -> list[Along]:
    """What acts along the motions of devices with the same band and bias, stage by stage.

    Parameters
    ----------
    devices, motions : of which (:func:`band_motion`).
    louds : samples of their volts near their peaks (``clipping``).
    sizes : of clipping (:func:`adc_sizes`, :func:`drive_sizes`).
    with_mismatch : whether the fits have electrode mismatches.
    """
    signals = [own for _, own in motions]
    forces = forces_of(devices, signals, sizes, with_mismatch)
    adc = [adc_changes(*one, with_mismatch) for one in zip(devices, louds, sizes)]
    sense = [sense_changes(*one, with_mismatch) for one in zip(devices, signals)]
    times = time_changes(devices, [own for own, _ in motions], signals[0].grid, with_mismatch)
    return [Along(*motion, own, changed) for motion, own, changed in zip(motions, forces, zip(adc, sense, times))]


def signatures(device: LinearDevice, moved: Moved, with_mismatch: bool, slopes: FloatArray, along: Along) -> Found:
    """All signatures of the effects that a fit lacks.

    Parameters
    ----------
    device, moved : at the maximum of the likelihood, in the band of a record (``linear_devices``).
    with_mismatch : whether the fit has electrode mismatches.
    slopes : of the fit, coefficients (P, S, J) of the features.
    along : what acts along its motion.
    """
    motion, forces, count = along.motion, along.forces, slopes.shape[0]
    mechanics, of_mechanics = mechanics_coefficients(device, moved, with_mismatch)
    senses, first = SHAPE.senses, count + 1
    rows = np.empty((first + most_signatures(with_mismatch, STAGES), senses, 2 * device.band.bins.size))
    # One product for all that is linear in the features.
    parts = (slopes, np.zeros((1, senses, slopes.shape[2])), of_mechanics)
    coefficients = np.concatenate(parts)
    device.rows(coefficients, rows[: coefficients.shape[0]])
    found = [Acting(probe, 1.0, 1) for probe in mechanics]

    def free() -> FloatArray:
        return rows[first + len(found) :]

    for changed in along.changed:
        write_real(changed.spectra, free()[: len(changed.acting)])
        found += changed.acting
    found += readout_signatures(device, motion, with_mismatch, free())
    device.forced(forces, along.signals.grid, free())
    found += [Acting(*one) for one in zip(forces.probes, forces.values, forces.orders)]
    return Found(tuple(found), rows[: first + len(found)], motion.sensed)
