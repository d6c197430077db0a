"""A run in the formats of other programs: CSV, Excel, STDF V4, wafer maps.

| format | suffix | files |
|---|---|---|
| csv | .csv | all columns of the devices table |
| xlsx | .xlsx | sheets yields, devices, limits, columns |
| stdf | .stdf | one file per lot |
| wafermap-png | .png | one page per lot |
| wafermap-csv | (csv) | one table: grid coordinates, bins |

A file replaces an older one as a whole, once it is complete.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import pyarrow.csv as pacsv

from pipeline.errors import UsageError, unwritable
from pipeline.store.columns import StoredRun, with_run
from pipeline.store.files import replacing
from pipeline.store.folders import PREFIX
from pipeline.store.read import find_run
from pipeline.store.schema import DEVICES
from reports.devices import Devices
from reports.limits import Limits
from reports.words.exports import cut_sentence, unfinished_sentence, unplaced_sentence

from ..config import config_of_run

if TYPE_CHECKING:
    from reports.run.content import RunContent

FORMATS = ("csv", "xlsx", "stdf", "wafermap-png", "wafermap-csv")
_BY_SUFFIX = {".csv": "csv", ".xlsx": "xlsx", ".stdf": "stdf", ".std": "stdf", ".png": "wafermap-png"}
_SUFFIX = {"csv": ".csv", "xlsx": ".xlsx", "stdf": ".stdf", "wafermap-png": ".png", "wafermap-csv": "-wafermap.csv"}
_DPI = 150.0


@dataclass(frozen=True)
class Exported:
    """The files that were written, and remarks on what the format could not hold."""

    files: tuple[Path, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class _File:
    """Where a file goes, and what writes it."""

    path: Path
    write: Callable[[BinaryIO], None]


def export(results: Path, run: str | None, format: str | None, out: Path | None) -> Exported:
    """Write a run in the format of another program.

    Parameters
    ----------
    results : folder that contains the runs.
    run : its id; ``None`` or "latest" is the newest.
    format : one of ``FORMATS``; ``None``: by the suffix of ``out``.
    out : the file; where there is a file per lot, ``-<lot>`` comes before its suffix.  Default: the run id with the suffix.

    Raises
    ------
    UsageError : an unknown format, no such run, no devices, or a file that cannot be written.
    ConfigError : a package of an extra is not installed.
    IntegrityError : the run is not what was committed.
    """
    chosen = _format(format, out)
    folder = find_run(results, run)
    name = folder.name.removeprefix(PREFIX)

    def written(tables: StoredRun) -> Exported:
        if not tables.devices.num_rows:
            raise UsageError(
                "the run has no devices to export",
                value=name,
                next_step=f"gyroscreen run --resume {name}, or name another run",
            )
        limits = config_of_run(tables.config_toml, f"run.toml of {name}").judged_by()
        files, remarks = _WRITERS[chosen](tables, limits, out or Path(f"{name}{_SUFFIX[chosen]}"))
        for file in files:
            _write(file)
        if tables.manifest.status != "complete":
            remarks.append(unfinished_sentence(name, tables.devices.num_rows))
        return Exported(tuple(file.path for file in files), tuple(remarks))

    return with_run(results, name, written)


def _format(format: str | None, out: Path | None) -> str:
    chosen = format or (None if out is None else _BY_SUFFIX.get(out.suffix.lower())) or ("csv" if out is None else "")
    if chosen not in FORMATS:
        raise UsageError(
            "unknown --format" if format else "the name of --out has the suffix of no format",
            value=format or str(out),
            allowed=", ".join(FORMATS),
            next_step="choose one of these with --format",
        )
    return chosen


def _write(file: _File) -> None:
    try:
        file.path.absolute().parent.mkdir(parents=True, exist_ok=True)
        with replacing(file.path.absolute().parent, file.path.name) as sink:
            file.write(sink)
    except OSError as error:
        raise unwritable("the export", file.path, error, "choose another file with --out") from None


Written = tuple[list[_File], list[str]]


def _csv(run: StoredRun, limits: Limits, out: Path) -> Written:
    def write(sink: BinaryIO) -> None:
        for k, batch in enumerate(run.devices.to_batches()):
            pacsv.write_csv(batch, sink, pacsv.WriteOptions(include_header=k == 0))

    return [_File(out, write)], []


def _wafer_csv(run: StoredRun, limits: Limits, out: Path) -> Written:
    from reports.export.wafer_table import wafer_table

    table = wafer_table(Devices(run.devices), limits)
    return [_File(out, lambda sink: pacsv.write_csv(table, sink))], _unplaced(table["die_x"].null_count)


def _unplaced(count: int) -> list[str]:
    return [unplaced_sentence(count)] if count else []


def _stdf(run: StoredRun, limits: Limits, out: Path) -> Written:
    from reports.export.stdf import NightIdentity, StdfNight, stdf_chunks, stdf_night

    version = str(run.manifest.provenance.get("versions", {}).get("gyroscreen", ""))
    identity = NightIdentity(run.manifest.run_id, run.manifest.created, run.manifest.finished, version)
    night = stdf_night(Devices(run.devices), limits, identity)
    cut = night.cut_texts()

    def writer(night: StdfNight, lot: str) -> Callable[[BinaryIO], None]:
        return lambda sink: sink.writelines(stdf_chunks(night, lot))

    lots = night.lot_names()
    files = [_File(_of_lot(out, lot, lots), writer(night, lot)) for lot in lots]
    return files, [*([cut_sentence(cut)] if cut else []), *_unplaced(int(np.sum(~night.dies.known)))]


def _of_lot(out: Path, lot: str, lots: Sequence[str]) -> Path:
    """The file of a lot: ``out`` itself where there is one lot; characters that no file name may have become "_"."""
    if len(lots) == 1:
        return out
    safe = "".join(one if one.isalnum() or one in "._-" else "_" for one in lot) or "no-lot"
    return out.with_name(f"{out.stem}-{safe}{out.suffix}")


def _maps(run: StoredRun, limits: Limits, out: Path) -> Written:
    from reports.html.style import style
    from reports.run.figures.wafermap import wafer_maps

    devices = Devices(run.devices)
    x, y, wafers, lots = devices.number("die_x_mm"), devices.number("die_y_mm"), devices.wafers(), devices.text("lot")
    verdicts = devices.text("verdict")
    placed = np.isfinite(x) & np.isfinite(y) & ~wafers.equals("")
    if not placed.any():
        raise UsageError(
            "no device of the run has a wafer and a die position, so there is no map",
            value=run.manifest.run_id,
            allowed="devices with wafer, die_x_mm and die_y_mm",
            next_step="export as csv",
        )
    names = sorted(lots.at(placed).counts())

    def writer(lot: str) -> Callable[[BinaryIO], None]:
        def write(sink: BinaryIO) -> None:
            here = placed & lots.equals(lot)
            own = wafers.at(here)
            drawing = wafer_maps(x[here], y[here], verdicts.at(here), own, most=len(own.counts()))
            with style():
                drawing.figure.savefig(sink, format="png", dpi=_DPI)

        return write

    return [_File(_of_lot(out, lot, names), writer(lot)) for lot in names], _unplaced(int(np.sum(~placed)))


def _excel(run: StoredRun, limits: Limits, out: Path) -> Written:
    from reports.export.excel import write_workbook
    from reports.export.sheets import night_sheets
    from reports.run.content import run_content

    content: RunContent = run_content(run, limits)
    sheets = night_sheets(run.devices, content, DEVICES)
    return [_File(out, lambda sink: write_workbook(sheets, sink))], []


_WRITERS: dict[str, Callable[[StoredRun, Limits, Path], Written]] = {
    "csv": _csv,
    "xlsx": _excel,
    "stdf": _stdf,
    "wafermap-png": _maps,
    "wafermap-csv": _wafer_csv,
}
