"""The door behind which all readers stand.

One format, one module; the suffix finds it.  Whatever a library behind the door does with a damaged file --
any exception, any warning -- comes out as one :class:`MeasurementError`.
"""

from __future__ import annotations

import difflib
import warnings
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from ....errors import ConfigError, MeasurementError, UsageError
from ...record import Record
from ..columns import assemble
from .table import Columns

#: Suffix -> module.  Modules are imported when they are needed: each brings a library of its own.
FORMATS: dict[str, str] = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".txt": "csv",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".npz": "npz",
    ".mat": "mat",
    ".tdms": "tdms",
}
#: What ``write_columns`` writes, and the suffix it gives.
WRITTEN: dict[str, str] = {
    "parquet": ".parquet",
    "csv": ".csv",
    "hdf5": ".h5",
    "npz": ".npz",
    "mat": ".mat",
    "tdms": ".tdms",
}


def _module(name: str) -> ModuleType:
    return import_module(f".{name}", __name__)


def existing(path: Path) -> Path:
    """``path`` if it is there, else an error that names the nearest that is."""
    if path.exists():
        return path
    try:
        beside = sorted(entry.name for entry in path.parent.iterdir())
    except OSError:
        beside = []
    near = difflib.get_close_matches(path.name, beside, n=1)
    raise MeasurementError(
        "no such file or folder",
        value=str(path),
        allowed=", ".join(beside[:8]) if beside else "a path that exists",
        next_step=f"did you mean {near[0]}" if near else "check the path",
    )


def read_columns(path: Path) -> Columns:
    """All numeric vectors of a file, by name, unchecked.

    Raises :class:`MeasurementError` for whatever goes wrong.
    """
    existing(path)
    name = FORMATS.get(path.suffix.lower())
    if name is None or not path.is_file():
        raise MeasurementError(
            "not a record of a known format" if path.is_file() else "a record is a file",
            value=str(path),
            allowed=", ".join(FORMATS),
            next_step="rename the file after its format, or convert it",
        )
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            # A library that warns about a file was not sure what it read; its own ageing is no concern of the
            # file's.
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", DeprecationWarning)
            warnings.simplefilter("ignore", PendingDeprecationWarning)
            warnings.simplefilter("ignore", FutureWarning)
            columns: Columns = _module(name).read(path)
    except MeasurementError as error:
        raise MeasurementError(
            f"{path.name}: {error.what}", value=error.value, allowed=error.allowed, next_step=error.next_step
        ) from error
    except MemoryError as error:
        raise MeasurementError(
            f"{path.name}: the file asks for more memory than there is",
            value=str(path),
            next_step="split the record, or copy the file again if it should be small",
        ) from error
    except Exception as error:
        # The one place where everything is caught: these libraries promise nothing about damaged files.
        raise MeasurementError(
            f"{path.name}: cannot be read as {name}",
            value=f"{type(error).__name__}: {error}"[:160],
            allowed=f"an undamaged {name} file with the columns time_s, drive1_V, sense1_V, ...",
            next_step="open the file with the program that wrote it, or copy it again",
        ) from error
    return columns


def read_record(path: Path, sample_rate_hz: float | None) -> Record:
    """One record from one file.

    Parameters
    ----------
    path : the file; its suffix says the format.
    sample_rate_hz : what the time column is held against (relative 1e-4), and what stands in for it where
        there is none;
        ``None`` takes the rate from the time column.

    Raises :class:`MeasurementError`.
    """
    return assemble(path.name, read_columns(path), sample_rate_hz)


def write_columns(folder: Path, stem: str, columns: Columns, form: str) -> Path:
    """Write ``columns`` to ``folder/stem`` plus the suffix of ``form``; returns the path.

    Raises :class:`UsageError` for an unknown format or a folder that cannot be written.
    """
    if form not in WRITTEN:
        raise UsageError(
            "unknown record format", value=form, allowed=", ".join(WRITTEN), next_step="choose one of them"
        )
    path = folder / (stem + WRITTEN[form])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _module(form).write(path, columns)
    except OSError as error:
        raise UsageError(
            "the record cannot be written",
            value=f"{path}: {error}",
            next_step="choose a folder that can be written",
        ) from error
    except MeasurementError as error:  # a missing extra
        raise ConfigError(error.what, allowed=error.allowed, next_step=error.next_step) from error
    return path
