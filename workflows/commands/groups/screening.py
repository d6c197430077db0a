"""Declaration of the commands of the screening run: run, rare, query, report, attribute, grr, export, verify."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.errors import UsageError

from . import complete
from .options import DEFAULT_RESULTS, Json, Results, RunId, Workers, only_with


def run(
    config: Annotated[Path | None, typer.Argument(help="Run configuration (TOML); default: 200 devices.")] = None,
    devices: Annotated[int | None, typer.Option(help="Number of virtual devices.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all random streams.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = DEFAULT_RESULTS,
    workers: Workers = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a running dask scheduler.")] = None,
    resume: Annotated[
        str | None, typer.Option(help="Id of an incomplete run, or 'latest'.", autocompletion=complete.runs)
    ] = None,
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
    if not (json or dry_run) and sys.stderr.isatty():
        # The imports take a second; the bar replaces this line.
        print("planning the run", end="\r", file=sys.stderr, flush=True)
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
    sql: Annotated[
        str, typer.Argument(help="One SELECT on the views devices, posterior, irregularities, runs, columns.")
    ],
    results: Results = DEFAULT_RESULTS,
    format: Annotated[
        str | None,
        typer.Option(
            help="table, csv, json or parquet; default: the suffix of --out, else table.",
            autocompletion=complete.one_of("table", "csv", "json", "parquet"),
        ),
    ] = None,
    run: Annotated[
        str, typer.Option(help="Id of the run to query, 'latest' or 'all'.", autocompletion=complete.runs_or_all)
    ] = "latest",
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
    run: RunId = None,
    results: Results = DEFAULT_RESULTS,
    out: Annotated[Path | None, typer.Option(help="Also write the page to this file.")] = None,
    limits: Annotated[
        Path | None,
        typer.Option("--limits", help="Judge the stored run again by these limits (TOML): a page of its own."),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            help="Compare with this run, or with 'last:N' nights: differences, control charts.",
            autocompletion=complete.runs_or_last,
        ),
    ] = None,
    alarm: Annotated[
        list[str] | None,
        typer.Option(help="With --against: false_alarm=0.01, yield.min=0.5, QUANTITY.max=..; sets the exit code 1."),
    ] = None,
    leave_out: Annotated[
        list[str] | None,
        typer.Option(
            "--leave-out",
            help="With --against last:N: an earlier run that does not count.",
            autocompletion=complete.runs,
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Write the report again, by other limits too; compare nights.

    With --limits, the stored posterior draws are judged again and a page beside the report shows what changes.  With --against, a
    comparison is stored as trend.html beside the report.  The report and the results stay as they are.
    """
    if against is not None:
        if limits is not None:
            raise UsageError(
                "--limits and --against are two questions",
                value="both",
                allowed="one of them",
                next_step="call the command once for each",
            )
        from ..trend import against as compare

        compare(run, results, against, alarm or [], leave_out or [], out, json)
        return
    only_with("--against", {"--alarm": alarm, "--leave-out": leave_out})
    from ..results import report as command

    command(run, results, out, limits, json)


def attribute(
    run: RunId = None,
    results: Results = DEFAULT_RESULTS,
    what_if: Annotated[
        str | None,
        typer.Option(
            "--what-if", help='Change of the population, as "spring_width.wafer_um*0.5, lid_leak.fraction=0.01".'
        ),
    ] = None,
    samples: Annotated[int, typer.Option(help="Virtual devices from which the shares are found.")] = 10_000,
    json: Json = False,
) -> None:
    """Attribute the loss of a run to irregularities and levels.

    With --what-if, the loss if the population were another one: the stored devices drawn again, and reweighted.
    """
    from ..attribute import attribute as command

    command(run, results, what_if, samples, json)


def grr(
    run: RunId = None,
    results: Results = DEFAULT_RESULTS,
    limits: Annotated[
        Path | None, typer.Option(help="Limits (TOML) for % tolerance; default: those of the run.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the page to this file; default: grr.html beside the report.")
    ] = None,
    json: Json = False,
) -> None:
    """Repeatability and reproducibility from repeated campaigns.

    The campaigns of a run name their device, tester and session in [conditions] of campaign.toml.
    """
    from ..grr import grr as command

    command(run, results, limits, out, json)


def export(
    run: RunId = None,
    results: Results = DEFAULT_RESULTS,
    format: Annotated[
        str | None,
        typer.Option(
            help="csv, xlsx, stdf, wafermap-png or wafermap-csv; default: the suffix of --out, else csv.",
            autocompletion=complete.one_of("csv", "xlsx", "stdf", "wafermap-png", "wafermap-csv"),
        ),
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


COMMANDS = (run, rare, query, report, attribute, grr, export, verify)
