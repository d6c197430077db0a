"""Declaration of the commands of `gyroscreen benchmark`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .lots import hidden_irregularities, lot_origin
from .options import Devices, Json, Seed, Workers

app = typer.Typer(help="Measure the performance that the documentation claims.", no_args_is_help=True)


@app.command()
def coverage(
    devices: Devices = 1000,
    splits: Annotated[
        str, typer.Option(help="'population', or 'small': log-uniform from 0.02 to 0.5 Hz.")
    ] = "population",
    noise: Annotated[
        str, typer.Option(help="'white' at 60 dB, or 'ar', '1/f', 'jitter', 'gain' as in [noise].")
    ] = "white",
    bad: Annotated[float, typer.Option(help="Share of bad samples (spikes, stuck samples) in each record.")] = 0.0,
    seed: Seed = 2026,
    workers: Workers = 0,
    json: Json = False,
) -> None:
    """Coverage of 90 % intervals, and error over the CRLB.

    The virtual devices are those of the default run.
    """
    from ..benchmark import coverage as command

    command(devices, splits, noise, bad, seed, workers, json)


@app.command()
def undetected(
    effect: Annotated[str, typer.Option(help="An effect that the nightly fit lacks, none, or all.")] = "all",
    devices: Annotated[int, typer.Option(help="Devices per effect.")] = 200,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "undetected"
    ),
    json: Json = False,
) -> None:
    """Coverage with undetected effects in nightly devices.

    Sizes run from invisible to loud. Intervals are widened by the bound of the bias that an undetected effect can cause.
    """
    from ..undetected import undetected as command

    command(effect, devices, seed, workers, out, json)


@app.command("foreign-gyros")
def foreign_gyros(
    kind: Annotated[str, typer.Option(help="both, alternate, displacement, pairs, four, or all.")] = "all",
    devices: Annotated[int, typer.Option(help="Devices per kind.")] = 100,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "foreign-gyros"
    ),
    json: Json = False,
) -> None:
    """Identify gyros of any frequency, Q and split.

    The gyros come from a simulator that shares no code with the model.
    """
    from ..foreign_gyros import foreign_gyros as command

    command(kind, devices, seed, workers, out, json)


@app.command("sweeps")
def sweeps(
    kind: Annotated[str, typer.Option(help="none, the name of an effect, or all.")] = "all",
    campaigns: Annotated[int, typer.Option(help="Campaigns per kind.")] = 15,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "sweeps"
    ),
    json: Json = False,
) -> None:
    """Name the effect of one set of stepped sweeps.

    The sweeps come from an integrator that shares no code with the model.
    """
    from ..sweeps import sweeps as command

    command(kind, campaigns, seed, workers, out, json)


@app.command("decays")
def decays(
    kind: Annotated[str, typer.Option(help="none, an effect, two_modes, or all.")] = "all",
    campaigns: Annotated[int, typer.Option(help="Decays per kind.")] = 100,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "decays"
    ),
    json: Json = False,
) -> None:
    """Name the effect of one free decay.

    The decays come from an integrator that shares no code with the model.
    """
    from ..decays import decays as command

    command(kind, campaigns, seed, workers, out, json)


@app.command("rare")
def rare(
    kind: Annotated[str, typer.Option(help="A limit state, such as linear-1e-6 or split-1ppm, or all.")] = "all",
    count: Annotated[int, typer.Option(help="Estimates per kind.")] = 400,
    plain: Annotated[int, typer.Option(help="Rows of 100,000 devices of plain Monte Carlo.")] = 100,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "rare"
    ),
    json: Json = False,
) -> None:
    """Bias and intervals of rare losses.

    Each is estimated from 20,000 devices.  The limit states are closed forms, and limits of the default population that plain
    Monte Carlo sees or that are lost at 1 ppm.
    """
    from ..rare_study import rare_study as command

    command(kind, count, plain, seed, workers, out, json)


@app.command()
def efficiency(
    cell: Annotated[str, typer.Option(help="As 60dB-1Hz, or all.")] = "all",
    devices: Annotated[int, typer.Option(help="Devices per cell.")] = 5000,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "efficiency"
    ),
    json: Json = False,
) -> None:
    """Errors of theta and split over their Cramer-Rao bounds.

    The cells are splits of 0.1 to 10 Hz at 40, 60 and 80 dB.
    """
    from ..efficiency import efficiency as command

    command(cell, devices, seed, workers, out, json)


@app.command()
def throughput(devices: Devices = 100, json: Json = False) -> None:
    """Devices per second on one core, and peak memory.

    Each device is simulated and identified, with its posterior.
    """
    from ..benchmark import throughput as command

    command(devices, json)


@app.command()
def scaling(
    kind: Annotated[str, typer.Option(help="device, order, duration, records, block, draws, stub, or all.")] = "all",
    largest: Annotated[int, typer.Option(help="Most devices of a run.")] = 1_000_000,
    devices: Annotated[int, typer.Option(help="Devices of the night whose cost is derived.")] = 10_000_000,
    seed: Seed = 1,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "scaling"
    ),
    json: Json = False,
) -> None:
    """Time, memory, files, query and report against the size.

    Runs of real devices and of stubs with the rows of real ones; derives the cost of a large night on a cluster.
    """
    from ..scaling import scaling as command

    command(kind, largest, devices, seed, out, json)


@app.command()
def faults(
    blocks: Annotated[int, typer.Option(help="Blocks of four stub devices.")] = 1000,
    kills: Annotated[int, typer.Option(help="Workers killed at random moments.")] = 60,
    seconds: Annotated[float, typer.Option(help="Duration of a stub device [s].")] = 0.5,
    commits: Annotated[int, typer.Option(help="Blocks committed to measure the cost of a commit.")] = 10_000,
    driver_kills: Annotated[int, typer.Option(help="Kills of the driver in a run of the same blocks.")] = 0,
    injected: Annotated[
        int, typer.Option(help="Blocks of a night with a device each that stops, crashes, loops and takes 5 GB.")
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder that keeps the runs of --driver-kills, --commits and --injected; again: goes on."),
    ] = None,
    seed: Seed = 1,
    workers: Workers = 0,
    json: Json = False,
) -> None:
    """Workers and drivers that die in a night; cost of a commit.

    Prints whether each device has exactly one row, what was computed twice, and commit time and memory against the block.
    """
    from ..benchmark import faults as command

    command(blocks, kills, seconds, commits, driver_kills, injected, out, seed, workers, json)


@app.command()
def sequential(
    devices: Devices = 500,
    near: Annotated[int, typer.Option(help="Devices near whose true values limits are put; the first ones.")] = 150,
    seed: Seed = 2026,
    workers: Workers = 0,
    json: Json = False,
) -> None:
    """Test duration and error rates of the sequential test.

    The sequential test is compared with P(conform) alone and with tests of fixed duration, over the population and against
    the distance from a limit.
    """
    from ..sequential import sequential as command

    command(devices, near, seed, workers, json)


@app.command()
def lattice(
    order: Annotated[int, typer.Option(help="Order of the ARX model.")] = 40,
    seconds: Annotated[float, typer.Option(help="Length of the record [s].")] = 3.0,
    json: Json = False,
) -> None:
    """Speed of the lattice filter on one core, over 10 kHz."""
    from ..sequential import lattice as command

    command(order, seconds, json)


@app.command()
def silverbox(
    data: Annotated[Path, typer.Argument(help="Folder that contains SNLS80mV.mat, the Silverbox measurement.")],
    hold: Annotated[str, typer.Option(help="Hold of the drive DAC: zoh, foh or bandlimited.")] = "bandlimited",
    json: Json = False,
) -> None:
    """Refine a model of a measured one-drive resonator.

    Prints the rms error in mV of each rung on the Silverbox measurement.
    """
    from ..silverbox import silverbox as command

    command(data, hold, json)


@app.command("hidden-effects")
def hidden_effects(
    kind: Annotated[
        str, typer.Option(help="none, one, weak, outside, left-out, two, .., bench, lone, or all.")
    ] = "all",
    campaigns: Annotated[int | None, typer.Option(help="Campaigns per kind; default: the full study.")] = None,
    only: Annotated[int | None, typer.Option(help="Number of one campaign of the kind; prints it in full.")] = None,
    seed: Seed = 1,
    workers: Workers = 0,
    out: Annotated[Path, typer.Option(help="Folder for the rows; an interrupted study continues there.")] = Path(
        "hidden"
    ),
    json: Json = False,
) -> None:
    """Hide effects by an independent simulator; count verdicts.

    Prints error rates, the power by SNR and the confusion matrices of diagnose and refine.
    """
    from ..hidden import hidden_effects as command

    command(kind, campaigns, only, seed, workers, out, json)


# Its name would cut the summaries of all others in the list; docs/how-to/lots.md names both.
app.command("hidden-irregularities", hidden=True)(hidden_irregularities)
app.command("lot-origin", hidden=True)(lot_origin)
