"""Declaration of the commands of the screening run: run, rare, query, report, export, verify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import DEFAULT_RESULTS, Json, Results, Workers


def run(
    config: Annotated[Path | None, typer.Argument(help="Run configuration (TOML); default: 200 devices.")] = None,
    devices: Annotated[int | None, typer.Option(help="Number of virtual devices.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all random streams.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = DEFAULT_RESULTS,
    workers: Workers = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a running dask scheduler.")] = None,
    resume: Annotated[str | None, typer.Option(help="Id of an incomplete run, or 'latest'.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check and print the configuration; run nothing.")] = False,
    json: Json = False,
    tls_ca: Annotated[Path | None, typer.Option("--tls-ca", help="With --scheduler: its authority (PEM).")] = None,
    tls_cert: Annotated[Path | None, typer.Option("--tls-cert", help="Certificate of this client (PEM).")] = None,
    tls_key: Annotated[Path | None, typer.Option("--tls-key", help="Key of this client (PEM).")] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Use a scheduler on another machine without encryption.")
    ] = False,
) -> None:
    """Identify and judge a batch of devices.

    The devices are drawn from a population and simulated, or they are measured campaigns.  The run writes its results and a
    report.
    """
    from ...screening.scheduler import scheduler_of
    from ..run import run as command

    chosen = scheduler_of(scheduler, tls_ca, tls_cert, tls_key, insecure)
    command(config, devices, seed, out, workers, chosen, resume, dry_run, json)


def rare(
    config: Annotated[
        Path | None, typer.Argument(help="Run configuration (TOML) with [sampling] and [limits].")
    ] = None,
    devices: Annotated[int | None, typer.Option(help="Virtual devices; default: sampling.devices.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all random streams.")] = None,
    json: Json = False,
) -> None:
    """Estimate rare losses of the population to the limits.

    Devices beyond each limit are searched for and weighted, so that losses of a few ppm need some ten thousand devices.
    """
    from ..rare import rare as command

    command(config, devices, seed, json)


def query(
    sql: Annotated[str, typer.Argument(help="One SELECT on the views devices, posterior, runs, columns.")],
    results: Results = DEFAULT_RESULTS,
    format: Annotated[
        str | None, typer.Option(help="table, csv, json or parquet; default: the suffix of --out, else table.")
    ] = None,
    run: Annotated[str, typer.Option(help="Id of the run to query, 'latest' or 'all'.")] = "latest",
    rows: Annotated[
        str | None, typer.Option(help="Rows to write, or 'all'; default: 1000 of a table on the screen, else all.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the answer to this file.")] = None,
) -> None:
    """Run one SQL query on the results of a run.

    The query runs in a process of its own, for at most 60 s and with at most 2 GB of memory.
    """
    from ..results import query as command

    command(sql, results, format, run, rows, out)


def report(
    run: Annotated[str | None, typer.Argument(help="Id of the run; default: the latest.")] = None,
    results: Results = DEFAULT_RESULTS,
    out: Annotated[Path | None, typer.Option(help="Also write the page to this file.")] = None,
) -> None:
    """Write the report of a run again."""
    from ..results import report as command

    command(run, results, out)


def export(
    run: Annotated[str | None, typer.Argument(help="Id of the run; default: the latest.")] = None,
    results: Results = DEFAULT_RESULTS,
    format: Annotated[
        str | None,
        typer.Option(help="csv, xlsx, stdf, wafermap-png or wafermap-csv; default: the suffix of --out, else csv."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The file; STDF files and map pages are one per lot, with its name added.")
    ] = None,
) -> None:
    """Write a run as CSV, Excel, STDF V4 or wafer maps.

    Wafer maps are pictures (wafermap-png) or a table (wafermap-csv).
    """
    from ..export import export as command

    command(run, results, format, out)


def verify(
    results: Results = DEFAULT_RESULTS,
    json: Json = False,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Compute damaged tables again; damaged files are kept in the folder 'damaged'."),
    ] = False,
) -> None:
    """Check that no stored result has changed since it was written.

    With --repair, damaged tables are computed again from the inputs that the run stored, and stored if they are equal to what was
    committed.
    """
    from ..results import verify as command

    command(results, json, repair)


COMMANDS = (run, rare, query, report, export, verify)
