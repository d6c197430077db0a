"""Effects: terms of the physics of a device and its read-out, one file each.

Each file in ``pipeline/device/effects``, or in a folder of the user, defines EFFECT = Effect(...): parameters, at most one
pure function per stage of the signal path (most effects have one stage), and declared properties.  No list of effects is
kept anywhere else.

| stage       | signature                                       | purpose |
|---|---|---|
| drive       | (v, p, context) -> u                            | samples (N, D) [V] to force; memoryless |
| mechanics   | (mechanics, p, context) -> Mechanics            | linear and time-invariant; may append coordinates |
| force       | (t, q, qd, u, p, laws, out) -> None             | compiled force law, see ``force_law``; may have memories |
| sense       | (x, xd, s, t, p, context) -> s                  | pick-off volts (M, S) from motion x (M, S) [V s] |
| readout     | (readout, p, context) -> Readout                | linear and time-invariant |
| adc         | (y, p, context) -> y                            | acts on the samples (N, S) [V] |
| disturbance | (t, p, context) -> basis (N, L)                 | regressors with a free amplitude per channel and record |

p (k,) are the parameters in the order of declaration, with families expanded.  At the null value no stage is called, so the
result is bit-identical to the model without the effect.

A force law with coordinates of its own, which its mechanics stage appends or which are memories, gets the place of the first
of them as one more number p[k].  A memory is an internal state h of first order: the velocity qd of its coordinate is h, what the
law adds to ``out`` there is h', and h is zero at the first sample.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any

from ..arrays import FloatArray
from ..errors import ConfigError
from ..user_code import content_digest, fault, fault_at, line_of
from . import effects as library
from .declared import LookAlike, SizeRange
from .force_law import Laws
from .mechanics import Mechanics
from .parameters import Parameter, Shape
from .readout import Readout

__all__ = ["Context", "Effect", "Laws", "LookAlike", "SizeRange", "find_effects", "load_effect", "numbered"]


_STAGES = ("drive", "mechanics", "force", "sense", "readout", "adc", "disturbance")


@dataclass(frozen=True)
class Context:
    """Conditions for all stages except force: biases [V], parameters of the plant by name, time before the record [s].

    ``derivative``: order of the derivative of the motion that the pick-offs sense; ``axes``: number of coordinates that
    nonlinear laws act on.
    """

    bias_v: float
    operating_bias_v: float
    plant: Mapping[str, Any]
    elapsed_s: float = 0.0
    derivative: int = 1
    axes: int = 1


@dataclass(frozen=True, repr=False)
class Effect:
    """One effect.  The stages are described at the head of the module.

    Parameters
    ----------
    name : name in model files and reports; also the name of the file.
    law : the equation, in plain text.
    latex : the equation for the manual; an effect of your own needs none.
    source : citation or derivation.
    signature : how records show the effect, in words.
    parameters : parameters and families, in the order in which ``p`` holds them.
    plants : plants to which it applies: "gyro", "updown" (gyros with that mode), "modal" (any channels), "resonator" (modal, one
        drive and one sense).
    condition : condition of a record that, if declared, fixes the only parameter: "rate", or none.
    demodulated : only demodulated records, sweeps of a lock-in amplifier, show it.
    depends_on_bias : the law contains the bias, so records at another bias help to identify the effect.
    mimics_hold : a wrongly declared hold of the drive samples looks like this effect.
    look_alikes : other effects that reproduce its records.
    resonance : names of the frequency [Hz] and damping ratio of an additional mode; its residue is free for every drive and
        sense, and the learning loop scans the two on a fine grid.
    mains_frequency : name of the parameter that is the mains frequency [Hz]; the effect is added if silence shows a mains line.
    potential : (q (M, n), p, axes) -> (M,), potential energy of ``force``, if the force has one; checked by a test.
    memories : number of internal states of ``force`` for each axis that nonlinear laws act on.
    size : plausible sizes; by default a tenth of the parameters' scales, up to their range.
    number : k of the k-th mode that one file adds (:func:`numbered`).

    Raises
    ------
    ConfigError : a required field is empty, no stage is given, a declared name is not a parameter, or a null value is out of
        range.
    """

    name: str
    law: str
    source: str
    signature: str
    parameters: tuple[Parameter, ...]
    drive: Callable[[FloatArray, FloatArray, Context], FloatArray] | None = None
    mechanics: Callable[[Mechanics, FloatArray, Context], Mechanics] | None = None
    force: Callable[[float, FloatArray, FloatArray, FloatArray, FloatArray, Laws, FloatArray], None] | None = None
    sense: Callable[[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, Context], FloatArray] | None = None
    readout: Callable[[Readout, FloatArray, Context], Readout] | None = None
    adc: Callable[[FloatArray, FloatArray, Context], FloatArray] | None = None
    disturbance: Callable[[FloatArray, FloatArray, Context], FloatArray] | None = None
    plants: tuple[str, ...] = ("gyro", "modal")
    condition: str = ""
    demodulated: bool = False
    depends_on_bias: bool = False
    mimics_hold: bool = False
    look_alikes: tuple[LookAlike, ...] = ()
    resonance: tuple[str, str] | None = None
    mains_frequency: str = ""
    potential: Callable[[FloatArray, FloatArray, int], FloatArray] | None = None
    memories: int = 0
    size: SizeRange | None = None
    number: int = 1
    latex: str = ""

    def __post_init__(self) -> None:
        for required in ("name", "law", "source", "signature", "parameters", "plants"):
            if not getattr(self, required):
                raise ConfigError(f"effect {self.name!r} does not declare {required}", next_step=f"declare {required}")
        if not self.stages:
            raise ConfigError("an effect without a stage", value=self.name, allowed=f"one of {', '.join(_STAGES)}")
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise ConfigError(f"effect {self.name!r} has two parameters with the same name", value=names)
        for parameter in self.parameters:
            if not (parameter.unit and parameter.meaning and parameter.low <= parameter.null <= parameter.high):
                raise ConfigError(
                    f"parameter of effect {self.name!r} lacks unit or meaning, or its null is out of range",
                    value=parameter.name,
                    allowed="low <= null <= high",
                )
        for name in (*(self.resonance or ()), *filter(None, [self.mains_frequency])):
            if name not in names:
                raise ConfigError(f"effect {self.name!r} has no such parameter", value=name, allowed=", ".join(names))
        if self.potential is not None and self.force is None:
            raise ConfigError(f"effect {self.name!r} declares a potential without a force", next_step="add the force")
        if self.memories < 0 or (self.memories and self.force is None):
            raise ConfigError(f"effect {self.name!r} declares memories without a force", next_step="add the force")

    def __repr__(self) -> str:
        return f"load_effect({self.origin!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        # Functions of a user's file cannot be pickled by name, so the receiver loads the file again.
        return (
            (load_effect, (self.origin,)) if self.number == 1 else (numbered, (load_effect(self.origin), self.number))
        )

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages of the effect, in the order of the signal path."""
        return tuple(stage for stage in _STAGES if getattr(self, stage) is not None)

    @property
    def origin(self) -> str:
        """Name of the module in ``pipeline.device.effects``, or path of the user's file."""
        function: Any = getattr(self, self.stages[0])
        module = str(function.__module__)
        return module.rpartition(".")[2] if module.startswith(library.__name__) else str(function.__code__.co_filename)

    @property
    def has_coordinates(self) -> bool:
        """Whether the force law acts on coordinates of its own, which the linear motion does not move."""
        return self.force is not None and (self.mechanics is not None or self.memories > 0)

    def members(self, shape: Shape) -> tuple[Parameter, ...]:
        """Parameters of the effect on a plant of ``shape`` with families expanded, in the order of ``p``."""
        return tuple(member for parameter in self.parameters for member in parameter.members(shape))

    def shows(self, shape: Shape) -> bool:
        """Whether records of a plant of ``shape`` can show the effect.

        Without a drive, free initial states hold what a linear read-out changes, and nothing excites an additional mode.
        """
        if not self.members(shape):
            return False
        return shape.drives > 0 or not (self.resonance or set(self.stages) <= {"drive", "readout"})

    def full_name(self, member: Parameter) -> str:
        """Name of a parameter in a model: "effect.parameter", or the name of the result quantity that it is."""
        return member.quantity or f"{self.name}.{member.name}"

    def direction(self, shape: Shape) -> Parameter | None:
        """The parameter that is an angle of a sense vector, defined modulo 180 deg; None if it has none."""
        return next((member for member in self.members(shape) if member.per == "direction"), None)

    @property
    def mode(self) -> tuple[str, str] | None:
        """Full names of the frequency and the damping ratio of the mode that it adds; None if it adds none."""
        return (
            None if self.resonance is None else (f"{self.name}.{self.resonance[0]}", f"{self.name}.{self.resonance[1]}")
        )

    def is_null(self, p: FloatArray, shape: Shape) -> bool:
        """Whether all parameters without a grid (or all, if each has one) are null at ``p`` (k,) [declared units]."""
        members = self.members(shape)
        gridded = all(member.grid for member in members)
        return all(value == member.null for value, member in zip(p.tolist(), members) if gridded or not member.grid)

    def clips(self, stage: str) -> bool:
        """Whether its only parameter is a clip level of a ``stage``, scanned relative to the samples there."""
        return self.stages == (stage,) and len(self.parameters) == 1 and bool(self.parameters[0].grid)


@lru_cache(maxsize=256)
def numbered(effect: Effect, k: int) -> Effect:
    """The same effect once more, as ``<name>_<k>``: an effect that adds a mode may act several times in one model."""
    return replace(effect, name=f"{effect.name}_{k}", number=k)


def _effect_of(module: ModuleType, where: str) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise ConfigError(
            "no EFFECT = Effect(...) in this file", value=where, next_step="see docs/how-to/add-an-effect.md"
        )
    return effect


def load_effect(origin: str) -> Effect:
    """The effect in a module of the library ("cubic_stiffness") or in a user's file ("/some/folder/my_effect.py").

    A file that was changed is read again, so that a notebook need not be started again.

    Raises
    ------
    ConfigError : the file cannot be read, fails when run, or defines no effect.
    """
    if not origin.endswith(".py"):
        return _effect_of(importlib.import_module(f"{library.__name__}.{origin}"), origin)
    return _user_effect(origin, content_digest(Path(origin)))


@lru_cache(maxsize=256)
def _user_effect(origin: str, digest: str) -> Effect:
    """The effect in a user's file with this content."""
    path = Path(origin)
    name = f"user_effect_{sha256(str(path.resolve()).encode()).hexdigest()[:12]}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError("not a Python file", value=origin)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    guide = "correct this line; see docs/how-to/add-an-effect.md"
    try:
        spec.loader.exec_module(module)
    except ConfigError as error:
        why = f"{error.what}: {error.value!r}" if error.value is not None else error.what
        line = line_of(error, origin)
        raise fault_at(
            "the declaration of an effect", why, origin, line, error.next_step or guide, error.allowed
        ) from error
    except Exception as error:
        raise fault("the file of an effect fails when it is run", error, origin, guide) from error
    return _effect_of(module, origin)


def find_effects(folders: Sequence[Path] = ()) -> dict[str, Effect]:
    """All effects by name, sorted: those of the library and every ``*.py`` in ``folders`` whose name does not start with "_".

    Raises
    ------
    ConfigError : a folder does not exist, a file fails, or two effects have the same name.
    """
    origins = sorted(module.name for module in pkgutil.iter_modules(library.__path__))
    for folder in folders:
        if not Path(folder).is_dir():
            raise ConfigError(
                "the folder of effects does not exist",
                value=str(folder),
                allowed="a folder of Python files, one effect each",
                next_step="correct --effects, or effect_folders of the model file",
            )
        origins += sorted(str(path.resolve()) for path in Path(folder).glob("*.py") if not path.name.startswith("_"))
    found: dict[str, Effect] = {}
    for origin in dict.fromkeys(origins):
        effect = load_effect(origin)
        if effect.name in found:
            raise ConfigError(
                "two effects with the same name",
                value=effect.name,
                next_step=f"rename the one in {origin} (name = ...)",
            )
        found[effect.name] = effect
    return dict(sorted(found.items()))
