"""Effects: terms of the physics of a device and its read-out, one file each, found by themselves.

A file in ``pipeline/device/effects`` or in a user's folder holds  EFFECT = Effect(...): frozen parameters, and one pure
function for each stage of the signal path that the effect touches (most touch one):

| stage       | signature                                       | what it may do |
|---|---|---|
| drive       | (v, p, context) -> u                            | samples (N, D) [V] that make force; memoryless |
| mechanics   | (mechanics, p, context) -> Mechanics            | linear and time-invariant; may append coordinates |
| force       | (t, q, qd, u, p, laws, out) -> None             | adds acceleration (n,) [V/s] to ``out``; compiled   |
| sense       | (x, xd, s, t, p, context) -> s                  | pick-off volts (M, S) from motion x (M, S) [V s] |
| readout     | (readout, p, context) -> Readout                | linear and time-invariant |
| adc         | (y, p, context) -> y                            | on the samples (N, S) [V] |
| disturbance | (t, p, context) -> basis (N, L)                 | regressors with a free amplitude a channel and record |

p (k,) are the effect's parameters in the order declared, families spread out.  At the null value the stages are not
even called, so the null is no effect bit by bit.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from numba import njit, types
from numba.core.errors import NumbaExperimentalFeatureWarning

from ..arrays import FloatArray
from ..errors import ConfigError
from ..threads import once
from . import effects as library
from .mechanics import Mechanics
from .parameters import Parameter, Shape
from .readout import Readout


class Laws(NamedTuple):
    """What force laws may use of the linear mechanics and of the record.

    damping, stiffness (n, n); drive (n, D); motion (D, n): x = motion q is the motion [V s] of the drive electrodes;
    bias_v of the record and operating_bias_v of the device [V]; ``axes``: nonlinear laws act on the first so many
    coordinates.
    """

    damping: FloatArray
    stiffness: FloatArray
    drive: FloatArray
    motion: FloatArray
    bias_v: float
    operating_bias_v: float
    axes: int


@dataclass(frozen=True)
class Context:
    """What the other stages may use: biases [V], and the plant's parameters by name."""

    bias_v: float
    operating_bias_v: float
    plant: Mapping[str, Any]


_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")
LAWS_TYPE = types.NamedTuple((_MATRIX, _MATRIX, _MATRIX, _MATRIX, types.float64, types.float64, types.int64), Laws)
FORCE_SIGNATURE = types.void(types.float64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, LAWS_TYPE, _VECTOR)
# Function pointers in tuples are what keeps the one integrator from being compiled again for every combination.  Filters are
# set once: setting them around each call is not safe with threads.
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)
FORCE_TYPE = types.FunctionType(FORCE_SIGNATURE)

_STAGES = ("drive", "mechanics", "force", "sense", "readout", "adc", "disturbance")


@dataclass(frozen=True, repr=False)
class Effect:
    """One effect (stages at the head of the module).

    Parameters
    ----------
    name : the name in model files and reports; also the file's name.
    law : the equation.
    source : citation or derivation.
    signature : how a record shows it.
    parameters : parameters and families, in the order in which ``p`` holds them.
    plants : where it makes sense: "gyro", "modal" (any channels), "resonator" (modal, one drive and one sense).
    condition : declared condition of a record that fixes the (only) parameter: "rate", or none.

    Raises
    ------
    ConfigError : something is not declared, no stage is given, or a null value lies outside its range.
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

    def __post_init__(self) -> None:
        for field in ("name", "law", "source", "signature", "parameters", "plants"):
            if not getattr(self, field):
                raise ConfigError(f"effect {self.name!r} does not declare {field}", next_step="fill it in")
        if not self.stages:
            raise ConfigError("an effect without a stage", value=self.name, allowed=f"one of {', '.join(_STAGES)}")
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise ConfigError(f"effect {self.name!r} has two parameters of one name", value=names)
        for parameter in self.parameters:
            if not (parameter.unit and parameter.meaning and parameter.low <= parameter.null <= parameter.high):
                raise ConfigError(
                    f"parameter of effect {self.name!r} lacks unit or meaning, or its null is out of range",
                    value=parameter.name,
                    allowed="low <= null <= high",
                )

    def __repr__(self) -> str:
        return f"load_effect({self.origin!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        # Functions of a user's file cannot be pickled by name: the file is read again on the other side.
        return load_effect, (self.origin,)

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages it touches, in the order of the signal."""
        return tuple(stage for stage in _STAGES if getattr(self, stage) is not None)

    @property
    def origin(self) -> str:
        """Name of the library module, or path of the user's file."""
        function: Any = getattr(self, self.stages[0])
        module = str(function.__module__)
        return module.rpartition(".")[2] if module.startswith(library.__name__) else str(function.__code__.co_filename)

    def members(self, shape: Shape) -> tuple[Parameter, ...]:
        """Its parameters on a plant of ``shape``, families spread out: the order of ``p``."""
        return tuple(member for parameter in self.parameters for member in parameter.members(shape))

    def full_name(self, member: Parameter) -> str:
        """Name of a parameter in a model: "effect.parameter", or the result quantity that it is."""
        return member.quantity or f"{self.name}.{member.name}"

    def is_null(self, p: FloatArray, shape: Shape) -> bool:
        """Whether ``p`` is no effect: all parameters that exist at the null are there."""
        members = self.members(shape)
        if all(member.grid for member in members):
            return all(value == member.null for value, member in zip(p, members))
        return all(value == member.null for value, member in zip(p, members) if not member.grid)


@once
def compiled_force(force: Callable[..., None]) -> Any:
    """``force`` compiled to the one signature that the integrator calls.

    Raises
    ------
    ConfigError : numba cannot compile it.
    """
    try:
        return njit(FORCE_SIGNATURE, cache=True, error_model="numpy")(force)
    except Exception as error:
        raise ConfigError(
            "the force law of an effect does not compile",
            value=f"{force.__module__}: {str(error).strip().splitlines()[0] if str(error).strip() else error}",
            allowed="plain arithmetic on numbers and arrays",
            next_step="see docs/add-an-effect.md",
        ) from error


def _effect_of(module: ModuleType, where: str) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise ConfigError("no EFFECT = Effect(...) in this file", value=where, next_step="see docs/add-an-effect.md")
    return effect


@lru_cache(maxsize=256)
def load_effect(origin: str) -> Effect:
    """The effect of a library module ("cubic_stiffness") or of a user's file ("/some/folder/my_effect.py").

    Raises
    ------
    ConfigError : the file cannot be read or run, or holds no effect.
    """
    if not origin.endswith(".py"):
        return _effect_of(importlib.import_module(f"{library.__name__}.{origin}"), origin)
    path = Path(origin)
    name = f"user_effect_{sha256(str(path.resolve()).encode()).hexdigest()[:12]}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError("not a Python file", value=origin)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except ConfigError:
        raise
    except Exception as error:
        raise ConfigError(
            "the file of an effect fails when run",
            value=f"{origin}: {type(error).__name__}: {error}",
            next_step="run it with python to see where",
        ) from error
    return _effect_of(module, origin)


def find_effects(folders: Sequence[Path] = ()) -> dict[str, Effect]:
    """All effects by name, sorted: the library's, then every ``*.py`` in ``folders`` not starting with "_".

    Raises
    ------
    ConfigError : a folder does not exist, a file fails, or two effects have one name.
    """
    origins = sorted(module.name for module in pkgutil.iter_modules(library.__path__))
    for folder in folders:
        if not Path(folder).is_dir():
            raise ConfigError("no such folder of effects", value=str(folder))
        origins += sorted(str(path.resolve()) for path in Path(folder).glob("*.py") if not path.name.startswith("_"))
    found: dict[str, Effect] = {}
    for origin in dict.fromkeys(origins):
        effect = load_effect(origin)
        if effect.name in found:
            raise ConfigError(
                "two effects of one name", value=effect.name, next_step=f"rename the one in {origin} (name = ...)"
            )
        found[effect.name] = effect
    return dict(sorted(found.items()))
