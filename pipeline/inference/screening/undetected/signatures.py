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

import numpy as np

from ....arrays import FloatArray
from .clipping import adc_signature
from .library import BandSignature, probed, scored_effects
from .linear import LinearDevice
from .linear_stages import mechanics_signatures, readout_signatures
from .narrow_band import grid_of
from .nonlinear import BandForce, drive_forces, forces_of, sense_signatures


def signatures(
    device: LinearDevice, model_v: FloatArray, probes: Mapping[str, float], with_mismatch: bool
) -> tuple[BandSignature, ...]:
    """All signatures of the effects that a fit lacks.

    Parameters
    ----------
    device : at the maximum of the likelihood, in the band of a record.
    model_v : its volts (N, S) [V].
    probes : of the ADC stage (:func:`adc_probes`).
    with_mismatch : whether the fit has electrode mismatches.
    """
    effects = scored_effects(with_mismatch)
    signals = device.signals(grid_of(device.band))
    found: list[BandSignature] = []
    forces: list[BandForce] = []
    forces += forces_of([effect for effect in effects if effect.force is not None], device, signals)
    for effect in effects:
        if effect.drive is not None:
            forces += drive_forces(effect, device, signals)
        if effect.adc is not None:
            found += [adc_signature(effect, device, model_v, probes[effect.name])] if effect.name in probes else []
    found += sense_signatures([effect for effect in effects if effect.sense is not None], device, signals)
    found += mechanics_signatures(device, effects)
    found += readout_signatures(device, effects)
    if forces:
        volts = device.forced(np.stack([force.envelope for force in forces]), signals.grid)
        found += [probed(f.effect, f.member, y, f.probe, f.order) for f, y in zip(forces, volts)]
    return tuple(sorted(found, key=lambda one: one.effect))
