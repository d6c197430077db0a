"""An irregularity: what fabrication or packaging does to a device.  One file each, found by itself.

An irregularity is data (stage, parameters, source) and one pure function ``act(values, site) -> Change``.
Changes add up (stiffness, area, pressure and the like as logarithms), so neither the order nor the number of
the irregularities matters, and one whose parameters are null changes nothing, to the bit.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Literal

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.errors import ConfigError

from .site import Site

Stage = Literal["fabrication", "probe", "package"]
"""fabrication: stays with the device; probe: only seen by the wafer prober; package: only in the package."""


@dataclass(frozen=True)
class Change:
    """What an irregularity adds to the structure of B devices; ``None`` adds nothing.

    Shapes: (B,), springs (J, B), electrodes (4, B) in the order D1, D2, S1, S2.  A vector or a 2-theta
    quantity is complex.
    """

    ln_stiffness: FloatArray | None = None  # of all springs, (B,)
    ln_spring: FloatArray | None = None  # of each spring, (J, B)
    azimuth_rad: FloatArray | None = None  # of each spring, (J, B)
    anisotropy: ComplexArray | None = None  # e: K = K0 (1 + [[Re e, Im e], [Im e, -Re e]]), (B,)
    post_offset_mm: ComplexArray | None = None  # x + i y of the post's centre of mass, (B,)
    ln_area: FloatArray | None = None  # of the electrodes, (4, B)
    ln_gap: FloatArray | None = None  # (4, B)
    ln_arm: FloatArray | None = None  # distance of an electrode's centroid from the centre, (4, B)
    ln_channel: FloatArray | None = None  # gain of the tester's channels, (4, B)
    ln_pressure: FloatArray | None = None  # of the gas around the device, (B,)
    ln_gas: FloatArray | None = None  # gas damping at a given pressure: rocking, up-down, (2, B)
    ln_anchor: FloatArray | None = None  # anchor loss, (B,)
    damping_anisotropy: ComplexArray | None = None  # as anisotropy, of C, (B,)


CHANGES: tuple[str, ...] = tuple(field.name for field in fields(Change))


@dataclass(frozen=True)
class IrregularityParameter:
    """One number of an irregularity.

    ``null`` is the value of no effect, taken when the TOML leaves the parameter out; without one (``None``)
    the TOML must state it.  ``assumption`` names the parameter among those that a study can sweep by that
    name.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    null: float | None = 0.0
    assumption: str = ""


#: The name by which the documentation imports it.
Parameter = IrregularityParameter


@dataclass(frozen=True)
class Irregularity:
    """Name, stage, parameters, law and where the law comes from."""

    name: str
    stage: Stage
    parameters: tuple[IrregularityParameter, ...]
    source: str
    act: Callable[[Mapping[str, float], Site], Change]


@lru_cache(maxsize=32)
def find(folders: tuple[str, ...] = ()) -> Mapping[str, Irregularity]:
    """All irregularities by name: those shipped, then those in ``folders`` (one ``IRREGULARITY`` in each file).

    Raises ConfigError when a folder is missing, a file cannot be imported or holds none, or a name is taken.
    """
    from . import irregularities

    modules: list[tuple[str, ModuleType]] = [
        (info.name, importlib.import_module(f"{irregularities.__name__}.{info.name}"))
        for info in pkgutil.iter_modules(irregularities.__path__)
    ]
    for folder in folders:
        if not Path(folder).is_dir():
            raise ConfigError(
                "irregularity_folders names no folder",
                value=folder,
                allowed="an existing folder, relative to the population TOML",
                next_step="correct irregularity_folders",
            )
        modules += [
            (str(path), _load(path)) for path in sorted(Path(folder).glob("*.py")) if not path.name.startswith("_")
        ]
    found: dict[str, Irregularity] = {}
    for where, module in modules:
        irregularity = getattr(module, "IRREGULARITY", None)
        if not isinstance(irregularity, Irregularity) or irregularity.name in found:
            raise ConfigError(
                f"{where} must define one IRREGULARITY with a name of its own",
                value=irregularity,
                allowed=f"a populations.irregularity.Irregularity not named {', '.join(sorted(found))}",
                next_step="see populations/README.md",
            )
        found[irregularity.name] = irregularity
    return dict(sorted(found.items()))


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"irregularity_{path.stem}", path)
    # The suffix .py guarantees a spec with a loader.
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ConfigError(
            f"irregularity file {path} cannot be imported ({type(error).__name__}: {error})",
            allowed="a Python file that defines IRREGULARITY",
            next_step="mend it, see populations/README.md",
        ) from error
    return module
