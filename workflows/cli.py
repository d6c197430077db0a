"""The command line.  Each command imports what it needs when it runs, so that --help answers at once.

Exit codes: 0 done; 1 a gate that the user set failed; 2 usage or config; 3 incomplete, can be resumed; 4 integrity;
5 unreadable measurement; 70 a fault of gyroscreen itself; 130 interrupted.
"""

from __future__ import annotations

import gc
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer.exceptions import TyperException

from pipeline.errors import GyroscreenError

from .machine import keep_memory

app = typer.Typer(
    name="gyroscreen",
    help="Monte Carlo fabrication screening of MEMS gyroscopes, and a bench on which a model meets measurements.",
    invoke_without_command=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout and nothing else.")]
Results = Annotated[Path, typer.Option("--results", help="Folder of the runs.")]
DEFAULT_RESULTS = Path("results")


@app.callback()
def _options(
    context: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    if version:
        from importlib import metadata

        print(f"gyroscreen {metadata.version('gyroscreen')}")
        raise typer.Exit
    if debug:
        os.environ["GYROSCREEN_DEBUG"] = "1"
    if context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def run(
    config: Annotated[Path | None, typer.Argument(help="Run configuration; the shipped default without it.")] = None,
    devices: Annotated[int | None, typer.Option(help="Number of virtual devices.")] = None,
    seed: Annotated[int | None, typer.Option(help="Root of all random streams.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = DEFAULT_RESULTS,
    workers: Annotated[int, typer.Option(help="Local worker processes; 0: one a core.")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of a running dask scheduler.")] = None,
    resume: Annotated[str | None, typer.Option(help="Go on with this run ('latest': the newest).")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check and show what would run; run nothing.")] = False,
    json: Json = False,
) -> None:
    """Sample, chirp, identify and judge a population (or measured campaigns); leave results and a report."""
    from .commands.run import run as command

    command(config, devices, seed, out, workers, scheduler, resume, dry_run, json)


@app.command()
def query(
    sql: Annotated[str, typer.Argument(help="One SELECT over devices, posterior, runs, columns.")],
    results: Results = DEFAULT_RESULTS,
    format: Annotated[str, typer.Option(help="table, csv, json or parquet.")] = "table",
) -> None:
    """Answer SQL on the results."""
    from .commands.results import query as command

    command(sql, results, format)


@app.command()
def report(
    run: Annotated[str | None, typer.Argument(help="Run; the newest without it.")] = None,
    results: Results = DEFAULT_RESULTS,
    out: Annotated[Path | None, typer.Option(help="Also write the page here.")] = None,
) -> None:
    """Write the report of a run again."""
    from .commands.results import report as command

    command(run, results, out)


@app.command()
def verify(results: Results = DEFAULT_RESULTS, json: Json = False) -> None:
    """Check that all results are what was committed."""
    from .commands.results import verify as command

    command(results, json)


@app.command()
def identify(
    measurement: Annotated[Path, typer.Argument(help="A record, a campaign folder, or a modal record (TOML).")],
    model: Annotated[Path | None, typer.Option(help="Model file; the screening model without it.")] = None,
    stream: Annotated[bool, typer.Option("--stream", help="Follow a record that grows ('-': stdin).")] = False,
    campaign: Annotated[Path | None, typer.Option(help="With --stream: instrument and noise of this campaign.")] = None,
    sigma_v: Annotated[float | None, typer.Option(help="With --stream: noise of the senses [V].")] = None,
    limits: Annotated[Path | None, typer.Option(help="With --stream: limits and rule (TOML).")] = None,
    decide: Annotated[bool, typer.Option("--decide", help="With --stream: stop when pass or fail is certain.")] = False,
    json: Json = False,
) -> None:
    """Identify one device: theta, split and the rest, with their uncertainty."""
    if stream:
        from .commands.stream import stream as follow

        follow(measurement, json, campaign, sigma_v, limits, decide=decide)
        return
    from .commands.identify import identify as command

    command(measurement, model, json)


@app.command()
def paper(out: Annotated[Path, typer.Option(help="Folder of the page.")] = Path("paper"), json: Json = False) -> None:
    """Redraw the paper: its figures, and its numbers beside ours, on one page."""
    from .commands.paper import paper as command

    command(out, json)


@app.command()
def check(campaign: Annotated[Path, typer.Argument(help="A campaign folder or a record.")], json: Json = False) -> None:
    """Look at a campaign before any fit; print the TOML lines that mend what is wrong."""
    from .commands.identify import check as command

    command(campaign, json)


Folders = Annotated[list[Path] | None, typer.Option("--effects", help="Folder of your own effects; may repeat.")]


@app.command()
def simulate(
    out_dir: Annotated[Path, typer.Argument(help="Folder of the campaign to write.")],
    config: Annotated[Path | None, typer.Option(help="Instrument, noise and hum (a run configuration).")] = None,
    device: Annotated[str, typer.Option(help="Plant parameters, as theta_deg=12,split_hz=1.5.")] = "",
    effect: Annotated[list[str] | None, typer.Option(help="NAME or NAME:param=value,..; may repeat.")] = None,
    seed: Annotated[int, typer.Option(help="Device, sizes of effects and noise.")] = 1,
    effects: Folders = None,
) -> None:
    """Measure a virtual device: write its campaign, and the truth beside it."""
    from .commands.model import simulate as command

    command(out_dir, config, device, effect or [], seed, effects or [])


CampaignFolder = Annotated[Path, typer.Argument(help="A campaign folder or a record.")]
ModelOption = Annotated[Path | None, typer.Option("--model", help="Model file; the paper's own without it.")]
PageFolder = Annotated[Path | None, typer.Option("--out", help="Also write the page (and files) here.")]


@app.command()
def compare(
    campaign: CampaignFolder,
    model: ModelOption = None,
    out: PageFolder = None,
    effects: Folders = None,
    json: Json = False,
) -> None:
    """Fit the model to a campaign: how good is it, and where does it fail?"""
    from .commands.learn import compare as command

    command(campaign, model, out, effects or [], json)


@app.command()
def diagnose(
    campaign: CampaignFolder,
    model: ModelOption = None,
    out: PageFolder = None,
    effects: Folders = None,
    json: Json = False,
) -> None:
    """Which physical effect is missing (or that none of the known ones is)?"""
    from .commands.learn import diagnose as command

    command(campaign, model, out, effects or [], json)


@app.command()
def refine(
    campaign: CampaignFolder,
    model: ModelOption = None,
    out: PageFolder = None,
    effects: Folders = None,
    json: Json = False,
) -> None:
    """Diagnose, add, refit, until nothing more is warranted; show the ladder."""
    from .commands.learn import refine as command

    command(campaign, model, out, effects or [], json)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder of the page.")] = Path("demo"),
    seed: Annotated[int | None, typer.Option(help="Which device and effect; random without it.")] = None,
) -> None:
    """Hide a random effect in a virtual device, run the loop, draw the ladder, reveal the truth."""
    from .commands.learn import demo as command

    command(out, seed)


@app.command("effects")
def effects_(
    name: Annotated[str | None, typer.Argument(help="One effect in full; all by their laws without it.")] = None,
    effects: Folders = None,
) -> None:
    """List the effects that a device or its read-out may have."""
    from .commands.model import effects as command

    command(name, effects or [])


model = typer.Typer(help="Show, change and export models.", no_args_is_help=True)
app.add_typer(model, name="model")
ModelFile = Annotated[Path, typer.Argument(help="Model file (TOML).")]


@model.command()
def show(file: ModelFile) -> None:
    """Show a model file and its parameters."""
    from .commands.model import show as command

    command(file)


@model.command()
def add(effect: Annotated[str, typer.Argument(help="Effect.")], file: ModelFile, effects: Folders = None) -> None:
    """Add an effect; creates the file."""
    from .commands.model import change as command

    command(effect, file, True, effects or [])


@model.command()
def drop(effect: Annotated[str, typer.Argument(help="Effect.")], file: ModelFile) -> None:
    """Drop an effect."""
    from .commands.model import change as command

    command(effect, file, False, [])


@model.command()
def export(
    measurement: Annotated[Path, typer.Argument(help="A campaign folder or a record.")],
    out: Annotated[Path | None, typer.Option(help=".json or .mat; DEVICE.json without it.")] = None,
) -> None:
    """Identify a device and write its state space, continuous and ZOH, with covariance."""
    from .commands.model import export as command

    command(measurement, out)


benchmark = typer.Typer(help="Measure what the documents claim.", no_args_is_help=True)
app.add_typer(benchmark, name="benchmark")


@benchmark.command()
def coverage(
    devices: Annotated[int, typer.Option(help="Number of virtual devices.")] = 1000,
    splits: Annotated[
        str, typer.Option(help="'population', or 'small': log-uniform in 0.02 to 0.5 Hz.")
    ] = "population",
    seed: Annotated[int, typer.Option(help="Root of all random streams.")] = 2026,
    workers: Annotated[int, typer.Option(help="Local worker processes; 0: one a core.")] = 0,
    json: Json = False,
) -> None:
    """Coverage of the 90 % intervals, error against the Cramer-Rao bound and status, at 60 dB."""
    from .commands.benchmark import coverage as command

    command(devices, splits, seed, workers, json)


@benchmark.command()
def throughput(
    devices: Annotated[int, typer.Option(help="Number of virtual devices.")] = 100, json: Json = False
) -> None:
    """Devices per second of one core, and peak memory, for simulate + identify + posterior."""
    from .commands.benchmark import throughput as command

    command(devices, json)


@benchmark.command()
def sequential(
    devices: Annotated[int, typer.Option(help="Number of virtual devices.")] = 500,
    seed: Annotated[int, typer.Option(help="Root of all random streams.")] = 2026,
    workers: Annotated[int, typer.Option(help="Local worker processes; 0: one a core.")] = 0,
    json: Json = False,
) -> None:
    """How short the test may be: the sequential test against fixed durations, with its error rates."""
    from .commands.sequential import sequential as command

    command(devices, seed, workers, json)


@benchmark.command()
def lattice(
    order: Annotated[int, typer.Option(help="Order of the ARX model.")] = 40,
    seconds: Annotated[float, typer.Option(help="Length of the record.")] = 3.0,
    json: Json = False,
) -> None:
    """How many times faster than 10 kHz the lattice filter runs on one core."""
    from .commands.sequential import lattice as command

    command(order, seconds, json)


@benchmark.command()
def silverbox(
    data: Annotated[Path, typer.Argument(help="Folder of SNLS80mV.mat, the Silverbox measurement.")],
    hold: Annotated[str, typer.Option(help="How drive samples become volts: zoh, foh or bandlimited.")] = "bandlimited",
    json: Json = False,
) -> None:
    """The loop on a measured one-drive resonator: rms error in mV, rung by rung."""
    from .commands.silverbox import silverbox as command

    command(data, hold, json)


@benchmark.command("hidden-effects")
def hidden_effects(
    kind: Annotated[str, typer.Option(help="none, one, weak, outside, left-out, two, .. or all.")] = "all",
    campaigns: Annotated[int | None, typer.Option(help="How many of a kind; the full study without it.")] = None,
    only: Annotated[int | None, typer.Option(help="One campaign of the kind, in full.")] = None,
    seed: Annotated[int, typer.Option(help="Root of all random streams.")] = 1,
    workers: Annotated[int, typer.Option(help="Local worker processes; 0: one a core.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder of the rows; an interrupted study goes on.")] = Path("hidden"),
    json: Json = False,
) -> None:
    """Hide effects with an independent simulator, run the loop, publish the confusion matrix."""
    from .commands.hidden import hidden_effects as command

    command(kind, campaigns, only, seed, workers, out, json)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    # Before numpy is loaded: small matrices are slower on many threads, and workers share the cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # Huge pages take longer to come than records take to be worked through.
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
    # Looking for garbage among what was just loaded takes a fifth of the start, and once more at the end.
    gc.set_threshold(50_000)
    # A thread that comes back from a compiled loop waits for the others' Python no longer than this.
    sys.setswitchinterval(1e-3)
    keep_memory()
    code = call(arguments)
    # DuckDB counts what is left of it at the end, and complains.
    if "duckdb" not in sys.modules:
        gc.freeze()
    sys.exit(code)


def call(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code.  Errors become one message on stderr."""
    try:
        app(args=None if arguments is None else list(arguments), standalone_mode=False)
    except GyroscreenError as error:
        return _said(f"error: {error}", error.exit_code)
    except typer.Exit as exit_:
        return int(exit_.exit_code)
    except TyperException as error:
        said = error.format_message() if hasattr(error, "format_message") else str(error)
        return _said(f"error: {said}; next: gyroscreen --help", 2)
    except (KeyboardInterrupt, typer.Abort):
        return _said("interrupted; what was committed is kept: gyroscreen run --resume latest", 130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        # Nothing that a user does should come here; what does is a fault of ours, and says so.
        return _said(f"internal error: {type(error).__name__}: {error}; next: run again with --debug and report it", 70)
    return 0


def _said(message: str, code: int) -> int:
    if os.environ.get("GYROSCREEN_DEBUG"):
        traceback.print_exc()
    print(message, file=sys.stderr)
    return code
