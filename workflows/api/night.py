"""A night: the tables, yields, queries, report and exports of a stored run; see :mod:`workflows.api`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pyarrow as pa

from pipeline.arrays import FloatArray
from pipeline.errors import UsageError
from pipeline.quantities import NAMES
from pipeline.store.columns import StoredRun, StoredTable, with_run
from pipeline.store.folders import PREFIX
from pipeline.store.query import query as query_results
from pipeline.store.run import open_run as open_store
from pipeline.store.schema import COLUMNS
from reports.devices import Devices, rows_of
from reports.limits import Limits
from reports.run.content import RunContent, run_content
from reports.words.notebook import run_sentence
from reports.yields import Yield

from ..config import RunConfig, config_of_run
from ..screening import outcome
from ..stored_page import written_page

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")


@dataclass(frozen=True, eq=False, repr=False)
class ScreeningRun:
    """A stored run.  Its files are checked against their SHA-256 whenever tables are read.

    Parameters
    ----------
    results : folder that contains the runs.
    run_id : name of the run.
    """

    results: Path
    run_id: str

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.results / f"{PREFIX}{self.run_id}"

    @cached_property
    def config(self) -> RunConfig:
        """The configuration with which it was run."""
        return self.read(lambda run: config_of_run(run.config_toml, f"run.toml of {self.run_id}"))

    @property
    def limits(self) -> Limits:
        """The limits and the rule by which it was judged."""
        return self.config.judged_by()

    @cached_property
    def devices_table(self) -> pa.Table:
        """One row per device (Arrow), unit and meaning of each column in its field metadata.

        Raises
        ------
        IntegrityError : a file is not what was committed.
        """
        return self.read(lambda run: _whole(run.devices))

    @cached_property
    def posterior_table(self) -> pa.Table:
        """One row per posterior draw (Arrow); no rows where the run kept no draws.  Raises as :attr:`devices_table`."""
        return self.read(lambda run: _whole(run.posterior))

    @cached_property
    def devices(self) -> pd.DataFrame:
        """One row per device, by device_id; columns without any value are left out.  ``columns`` gives the units."""
        return _frame(self.devices_table).set_index("device_id")

    @cached_property
    def posterior(self) -> pd.DataFrame:
        """One row per draw, by device_id and draw; columns without any value are left out."""
        return _frame(self.posterior_table).set_index(["device_id", "draw"])

    @property
    def columns(self) -> pd.DataFrame:
        """Unit and meaning of each column of ``devices`` and ``posterior``."""
        import pandas as pd

        rows = [(one.table, one.name, one.unit, one.meaning) for one in COLUMNS]
        return pd.DataFrame(rows, columns=["table", "column", "unit", "meaning"]).set_index(["table", "column"])

    @cached_property
    def content(self) -> RunContent:
        """All numbers of the report."""
        found = outcome.lot_effects(open_store(self.results, self.run_id))
        return self.read(lambda run: run_content(run, self.limits, lot_effects=found))

    @property
    def yields(self) -> pd.DataFrame:
        """Yield of the run, of each lot and of each wafer: counts, share, and the 95 % interval [low, high] (shares of one).

        The interval is that of sampling (Clopper-Pearson), with the common errors of the tester where the run declares them.
        """
        import pandas as pd

        groups = [("", "", self.content.total)]
        groups += [(one.lot, one.wafer, one.result) for one in (*self.content.lots, *self.content.wafers)]
        rows = [(lot, wafer, *_counted(found)) for lot, wafer, found in groups]
        names = ["lot", "wafer", "devices", "passed", "failed", "undecided", "yield", "low", "high"]
        return pd.DataFrame(rows, columns=names).set_index(["lot", "wafer"])

    def query(self, sql: str) -> pd.DataFrame:
        """Answer one SELECT on the views devices, posterior, runs and columns of this run.

        Raises
        ------
        UsageError : not one SELECT, or SQL that DuckDB rejects; a result above 1 GiB or 60 s.

        Example
        -------
        >>> night.query("SELECT wafer, avg(split_hz) AS split FROM devices GROUP BY wafer")
        """
        return query_results(sql, self.results, run=self.run_id).to_pandas()

    def report(self, out: str | Path | None = None) -> Path:
        """Render the report again; into the run's folder, or to the file ``out``.  Returns its path.

        Raises
        ------
        UsageError : ``out`` cannot be written.
        IncompleteError : the run's folder cannot be written.
        """
        if out is None:
            return outcome.write_report(self.results, self.run_id)
        page = outcome.rendered_report(self.results, self.run_id)
        return written_page(page, Path(out), "choose another file")

    def draws_of(self, device_id: str) -> tuple[dict[str, FloatArray], dict[str, float]]:
        """Draws (n,) of a device by quantity, and its true values by true_<q>; only files that can hold it are read.

        Raises
        ------
        UsageError : no such device, or no draws of it.
        """
        device = Devices(self.read(lambda tables: rows_of(tables.devices, device_id)))
        if not len(device):
            raise UsageError(
                "the run has no such device",
                value=device_id,
                allowed="a device_id of the run",
                next_step="gs.open_run(...).devices.index lists them",
            )
        drawn = Devices(self.read(lambda tables: rows_of(tables.posterior, device_id)))
        if not len(drawn):
            raise UsageError(
                "the run kept no draws of this device",
                value=device_id,
                allowed="a device that was identified, in a run that stores draws",
                next_step="see the status of the device, and posterior.stored_draws of the run's configuration",
            )
        true = {f"true_{name}": float(device.number(f"true_{name}")[0]) for name in NAMES}
        known = {name: value for name, value in true.items() if math.isfinite(value)}
        return {name: drawn.number(name) for name in NAMES}, known

    def export(self, out: str | Path, format: str | None = None) -> tuple[Path, ...]:
        """Write the run for other programs; returns the files.

        Parameters
        ----------
        out : the file; its suffix chooses the format: .csv, .xlsx, .stdf (one per lot), .png (wafer maps, one page per lot).
        format : "csv", "xlsx", "stdf", "wafermap-png" or "wafermap-csv" instead.

        Raises
        ------
        UsageError : an unknown format, no devices, or a file that cannot be written.
        ConfigError : a package of an extra is not installed.

        Example
        -------
        >>> night.export("night.stdf")
        """
        from ..screening.exports import export

        return export(self.results, self.run_id, format, Path(out)).files

    def inference_data(self, device_id: str) -> Any:
        """The posterior draws of a device for ArviZ; see :func:`workflows.api.draws.inference_data`."""
        from .draws import inference_data

        return inference_data(self, device_id)

    def read(self, use: Callable[[StoredRun], T]) -> T:
        """``use(run)`` on the verified tables, which stay on disk and are read column by column."""
        return with_run(self.results, self.run_id, use)

    def __str__(self) -> str:
        return f"{run_sentence(self.run_id, self.content.total, self.content.identified)}\n{self.folder}"

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        from ..learning.tables import html

        return html(str(self).splitlines(), (self.yields,))


def _whole(table: StoredTable) -> pa.Table:
    return pa.Table.from_batches(table.to_batches(), schema=table.schema).combine_chunks()


def _frame(table: pa.Table) -> pd.DataFrame:
    """The table for pandas: numbers as float64, text as text, missing values as nan."""
    known = [name for name in table.column_names if table[name].null_count < table.num_rows or not table.num_rows]
    found: pd.DataFrame = table.select(known).to_pandas()
    return found


def _counted(found: Yield) -> tuple[int, int, int, int, float, float, float]:
    interval = found.clopper_pearson
    return found.devices, found.passed, found.failed, found.undecided, found.value, interval.low, interval.high
