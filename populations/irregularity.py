"""Irregularities: changes that fabrication or packaging makes to a device.  One file each, discovered automatically.

An irregularity consists of data (stage, parameters, source) and one pure function ``act(values, site) -> Change``.  Changes add
up (stiffness, area, pressure and similar quantities as logarithms), so the order of the irregularities does not matter, and an
irregularity at its null values changes nothing, to the bit.

Shapes: B devices, J springs, four electrodes D1, D2, S1, S2.
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
from pipeline.user_code import content_digest, fault

from .site import Site

Stage = Literal["fabrication", "probe", "package"]
"""fabrication: always present; probe: only in the wafer prober; package: only in the package."""


@dataclass(frozen=True)
class Change:
    """Changes of the structure of B devices; ``None`` is no change; shapes beside the fields.

    A vector or a 2-theta quantity is complex.  ``ln_`` marks the logarithm of a ratio to nominal [1]; others [rad, mm, 1].
    """

    ln_stiffness: FloatArray | None = None  # of all springs, (B,)
    ln_spring: FloatArray | None = None  # of each spring, (J, B)
    azimuth_rad: FloatArray | None = None  # of each spring, (J, B)
    anisotropy: ComplexArray | None = None  # e: K = K0 (1 + [[Re e, Im e], [Im e, -Re e]]), (B,)
    post_offset_mm: ComplexArray | None = None  # x + i y of the post's centre of mass, (B,)
    ln_area: FloatArray | None = None  # of each electrode, (4, B)
    ln_gap: FloatArray | None = None  # of each electrode, (4, B)
    ln_arm: FloatArray | None = None  # centre of the device to the centroid of each electrode, (4, B)
    ln_channel: FloatArray | None = None  # gain of each channel of the prober, (4, B)
    ln_pressure: FloatArray | None = None  # of the gas around the device, (B,)
    ln_gas: FloatArray | None = None  # gas damping at a given pressure: rocking, up-down, (2, B)
    ln_anchor: FloatArray | None = None  # anchor loss, (B,)
    damping_anisotropy: ComplexArray | None = None  # like anisotropy, for C, (B,)


CHANGES: tuple[str, ...] = tuple(field.name for field in fields(Change))


@dataclass(frozen=True)
class IrregularityParameter:
    """One parameter of an irregularity.

    ``null`` is the value without effect and the default; if it is ``None``, the TOML file must state the parameter.
    ``assumption`` is the name under which a study can vary the parameter.
    """

    name: str
    unit: str
    low: float
    high: float
    meaning: str
    null: float | None = 0.0
    assumption: str = ""


#: The documented name.
Parameter = IrregularityParameter


@dataclass(frozen=True)
class Irregularity:
    """Name, stage, parameters, source and law of an irregularity.

    ``latex`` is the equation for the manual; an irregularity of your own needs none.  The head of its
    file defines the symbols.
    """

    name: str
    stage: Stage
    parameters: tuple[IrregularityParameter, ...]
    source: str
    act: Callable[[Mapping[str, float], Site], Change]
    latex: str = ""


def find(folders: tuple[str, ...] = ()) -> Mapping[str, Irregularity]:
    """All irregularities by name: the shipped ones and those in ``folders``, with one ``IRREGULARITY`` in each file.

    A folder whose files were changed is read again.

    Raises
    ------
    ConfigError : a folder does not exist; a file cannot be imported or defines no irregularity; a name occurs twice.
    """
    files = [path for folder in folders for path in sorted(Path(folder).glob("*.py"))]
    return _found(folders, tuple(content_digest(path) for path in files))


@lru_cache(maxsize=32)
def _found(folders: tuple[str, ...], digests: tuple[str, ...]) -> Mapping[str, Irregularity]:
    """The same for files with these contents."""
    from . import irregularities

    modules: list[tuple[str, ModuleType]] = [
        (info.name, importlib.import_module(f"{irregularities.__name__}.{info.name}"))
        for info in pkgutil.iter_modules(irregularities.__path__)
    ]
    for folder in folders:
        if not Path(folder).is_dir():
            raise ConfigError(
                "irregularity_folders: the folder does not exist",
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
                f"{where} must define one IRREGULARITY with a unique name",
                value=irregularity,
                allowed=f"a populations.irregularity.Irregularity not named {', '.join(sorted(found))}",
                next_step="see docs/how-to/add-an-irregularity.md",
            )
        found[irregularity.name] = irregularity
    return dict(sorted(found.items()))


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"user_irregularity_{path.stem}", path)
    # The suffix .py guarantees a spec with a loader.
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise fault(
            "the file of an irregularity fails when it is run",
            error,
            path,
            "correct this line; see docs/how-to/add-an-irregularity.md",
            "a Python file that defines IRREGULARITY",
        ) from error
    return module
