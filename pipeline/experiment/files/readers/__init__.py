"""Read and write record files: the only entry point to the readers of the file formats.

Each format is one module, which the suffix of the file selects.  Any exception or warning that a library raises for a damaged
file becomes one :class:`MeasurementError`.

Shapes: columns (N,).
"""

from __future__ import annotations

import difflib
import warnings
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from ....errors import ConfigError, MeasurementError, UsageError, unwritable
from ....input_limits import check_path
from ...record import Record
from ..columns import assemble, only
from .table import Columns

#: Suffix -> module.  A module is imported only when it is needed, because each imports a library of its own.
FORMATS: dict[str, str] = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".txt": "csv",
    ".dat": "csv",
    ".asc": "csv",
    ".tsv": "csv",
    ".tab": "csv",
    ".prn": "csv",
    ".lvm": "lvm",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".npz": "npz",
    ".mat": "mat",
    ".tdms": "tdms",
    ".uff": "uff",
    ".unv": "uff",
    **{f".s{ports}p": "touchstone" for ports in range(1, 5)},
}
#: Formats that ``write_columns`` can write, and their suffixes.
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
    """``path`` if it exists.

    Raises
    ------
    MeasurementError : it does not; the message names the most similar file beside it.
    """
    check_path(path, "a measurement", MeasurementError)
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise MeasurementError(
            f"a path cannot be used: {(error.strerror or str(error)).lower()}",
            value=str(path),
            next_step="check the path and permissions",
        ) from error
    else:
        return path
    try:
        neighbours = sorted(entry.name for entry in path.parent.iterdir())
    except OSError:
        neighbours = []
    near = difflib.get_close_matches(path.name, neighbours, n=1)
    raise MeasurementError(
        "no such file or folder",
        value=str(path),
        allowed=", ".join(neighbours[:8]) if neighbours else "a path that exists",
        next_step=f"did you mean {near[0]}" if near else "check the path",
    )


def read_columns(path: Path) -> Columns:
    """All numeric vectors (N,) of a file by name, not yet checked (see ``columns.assemble``).

    Raises
    ------
    MeasurementError : the file is missing, damaged, too large or of an unknown format.
    """
    existing(path)
    name = FORMATS.get(path.suffix.lower())
    if name is None or not path.is_file():
        raise MeasurementError(
            "the file has no known format" if path.is_file() else "a record must be a file, not a folder",
            value=str(path),
            allowed=", ".join(FORMATS),
            next_step="give the file the suffix of its format, or convert it",
        )
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            # A warning means that the library guessed about the file, except for warnings about the library itself.
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
            f"{path.name}: the file needs more memory than is available",
            value=str(path),
            next_step="split the record; if the file should be small it is damaged, so copy it again from its source",
        ) from error
    except Exception as error:
        # Everything is caught here, because the libraries may raise anything for a damaged file.
        raise MeasurementError(
            f"{path.name}: cannot be read as {name}",
            value=f"{type(error).__name__}: {error}"[:160],
            allowed=f"an undamaged {name} file with the columns time_s, drive1_V, sense1_V, ...",
            next_step="open the file with the program that wrote it, or copy it again",
        ) from error
    return columns


def read_records(path: Path, sample_rate_hz: float | None) -> tuple[Record, ...]:
    """The record in a file; more than one where samples are missing.

    Parameters
    ----------
    path : the file; its suffix states the format.
    sample_rate_hz : declared sample rate [Hz], with which a time column must agree to a relative 1e-4; ``None`` takes the
        rate from the time column.

    Raises
    ------
    MeasurementError : the file cannot be read, or its columns are not a record.
    """
    return assemble(path.name, [read_columns(path)], sample_rate_hz)


def read_record(path: Path, sample_rate_hz: float | None) -> Record:
    """The record in a file without gaps; arguments and errors as :func:`read_records`."""
    return only(read_records(path, sample_rate_hz))


def write_columns(folder: Path, stem: str, columns: Columns, form: str) -> Path:
    """Write ``columns`` (N,) to ``folder/stem`` plus the suffix of the format ``form``; returns the path.

    Raises
    ------
    UsageError : unknown format, or the folder cannot be written.
    ConfigError : the format needs an optional package that is not installed.
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
        raise unwritable("the record", path, error) from error
    except MeasurementError as error:  # an optional package is missing
        raise ConfigError(error.what, allowed=error.allowed, next_step=error.next_step) from error
    return path
