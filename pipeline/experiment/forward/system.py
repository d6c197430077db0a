"""The system that a model at given parameters makes under the conditions of a record.

Effects act stage by stage in the order of the signal, and within a stage in the order of their names.  An effect at its null
does not act at all.  A declared angular rate acts whether or not the model contains ``angular_rate``.

Shapes: n coordinates, D drives, S senses, k parameters of an effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...device.effect import Context, Effect, Laws
from ...device.mechanics import Mechanics, widened
from ...device.model import Model
from ...device.readout import Readout, plain_readout
from ...errors import ConfigError
from ..antialias import filter_poles
from ..instrument import Instrument
from ..record import Record

_NO_POLES: ComplexArray = np.zeros(0, dtype=np.complex128)


@dataclass(frozen=True)
class Conditions:
    """Declared conditions of a record.

    Biases [V]; the angular rate Omega I_p/I_0p [rad/s], ``None`` where unknown; relative shift of all natural frequencies [1];
    time from the start of the run to the first sample [s].
    """

    bias_v: float
    operating_bias_v: float
    rate: float | None
    frequency_shift: float = 0.0
    elapsed_s: float = 0.0


def conditions_of(record: Record, instrument: Instrument, angular_gain: float | None) -> Conditions:
    """Conditions of a record; without the angular gain I_p/I_0p a rate other than zero counts as unknown."""
    rate: float | None = None
    if record.rate_dps is not None and (record.rate_dps == 0.0 or angular_gain is not None):
        rate = float(np.deg2rad(record.rate_dps)) * (angular_gain or 0.0)
    bias = instrument.bias_v if record.bias_v is None else record.bias_v
    return Conditions(bias, instrument.bias_v, rate, record.frequency_shift, record.elapsed_s)


@dataclass(frozen=True, eq=False)
class System:
    """Mechanics, read-out, and the effects of the other stages.

    Parameters
    ----------
    mechanics : a batch of one.
    readout : filter, delay, crosstalk and feedthrough.
    context : conditions and values that effects may use.
    sense_motion, drive_motion : (S, n) and (D, n) [1] as in ``device.plant``, zero for appended coordinates.
    axes : nonlinear laws act on the first ``axes`` coordinates.
    drives, forces, senses, adcs : effects of these stages, with their parameters (k,); a force law with coordinates of its own
        has the place of the first one as one more parameter.
    memories : memories of the force laws that are not coordinates yet (:attr:`integrated`).
    remembered : the last coordinates that are memories.
    """

    mechanics: Mechanics
    readout: Readout
    context: Context
    sense_motion: FloatArray
    drive_motion: FloatArray
    axes: int
    drives: tuple[tuple[Effect, FloatArray], ...]
    forces: tuple[tuple[Effect, FloatArray], ...]
    senses: tuple[tuple[Effect, FloatArray], ...]
    adcs: tuple[tuple[Effect, FloatArray], ...]
    memories: int = 0
    remembered: int = 0

    @property
    def integrated(self) -> System:
        """The system with one more coordinate for each memory, which nothing drives, senses or couples but the force laws.

        Linear responses need no memories: without stiffness they would be modes that do not oscillate.
        """
        if not self.memories:
            return self
        n = self.mechanics.stiffness.shape[1]
        return replace(
            self,
            mechanics=widened(self.mechanics, n + self.memories),
            sense_motion=_appended(self.sense_motion, n + self.memories),
            drive_motion=_appended(self.drive_motion, n + self.memories),
            memories=0,
            remembered=self.memories,
        )

    @property
    def laws(self) -> Laws:
        """Quantities that force functions may use."""
        m = self.mechanics
        return Laws(
            np.ascontiguousarray(m.damping[0]),
            np.ascontiguousarray(m.stiffness[0]),
            np.ascontiguousarray(m.drive[0]),
            np.ascontiguousarray(self.drive_motion),
            float(self.context.bias_v),
            float(self.context.operating_bias_v),
            self.axes,
            float(self.context.elapsed_s),
            self.remembered,
        )


def acting(model: Model, values: Mapping[str, float], conditions: Conditions) -> list[tuple[Effect, FloatArray]]:
    """Effects not at their null, with parameters (k,) [declared units], sorted by name; ``values`` must be complete."""
    shape = model.built.shape
    found: dict[str, tuple[Effect, FloatArray]] = {}
    for effect in model.ordered_effects():
        found[effect.name] = (effect, np.array([values[effect.full_name(m)] for m in effect.members(shape)]))
    if conditions.rate is not None:
        for effect in model.library.values():
            if effect.condition == "rate" and model.built.kinds & set(effect.plants):
                found[effect.name] = (effect, np.array([conditions.rate]))
    return [(effect, p) for _, (effect, p) in sorted(found.items()) if not effect.is_null(p, shape)]


def assemble(model: Model, values: Mapping[str, float], instrument: Instrument, conditions: Conditions) -> System:
    """The system at complete parameter ``values``.

    Raises
    ------
    ConfigError : the damping matrix is not positive semidefinite, or the stiffness matrix not positive definite.
    """
    plant = model.built
    effects = acting(model, values, conditions)
    mechanics = plant.mechanics(values)
    axes, declared = len(plant.shape.axes), conditions
    context = Context(
        declared.bias_v, declared.operating_bias_v, values, declared.elapsed_s, mechanics.derivative, axes
    )
    if conditions.frequency_shift != 0.0:
        mechanics = replace(mechanics, stiffness=mechanics.stiffness * (1.0 + conditions.frequency_shift) ** 2)
    poles, residues = (_NO_POLES, _NO_POLES) if instrument.antialias is None else filter_poles(instrument.antialias)
    readout = plain_readout(poles, residues, plant.shape.senses, plant.shape.drives)
    first: dict[str, int] = {}
    for effect, p in effects:
        if effect.mechanics is not None:
            first[effect.name] = mechanics.stiffness.shape[1]
            mechanics = effect.mechanics(mechanics, p, context)
        if effect.readout is not None:
            readout = effect.readout(readout, p, context)
    for what, matrix in (("damping", mechanics.damping[0]), ("stiffness", mechanics.stiffness[0])):
        lowest = np.linalg.eigvalsh(matrix)[0]
        if lowest < (-1e-9 * np.trace(matrix) if what == "damping" else 0.0):
            raise ConfigError(
                f"the {what} matrix has a negative eigenvalue",
                value=float(lowest),
                allowed="eigenvalues of at least 0: positive frequencies and damping, |c12| <= sqrt(c11 c22)",
                next_step="check the parameters of the model",
            )

    n, memories = mechanics.stiffness.shape[1], 0
    for effect, _ in effects:
        if effect.memories:
            first[effect.name] = n + memories
            memories += effect.memories * axes

    def of(stage: str) -> tuple[tuple[Any, FloatArray], ...]:
        own = tuple((effect, p) for effect, p in effects if getattr(effect, stage) is not None)
        if stage != "force":
            return own
        return tuple((e, np.append(p, first[e.name]) if e.has_coordinates else p) for e, p in own)

    return System(
        mechanics,
        readout,
        context,
        _appended(plant.sense_motion(), n),
        _appended(plant.drive_motion(), n),
        axes,
        of("drive"),
        of("force"),
        of("sense"),
        of("adc"),
        memories,
    )


def _appended(motion: FloatArray, n: int) -> FloatArray:
    """``motion`` (r, m) with zeros for the coordinates from m to n."""
    return np.concatenate([motion, np.zeros((motion.shape[0], n - motion.shape[1]))], axis=1)
