"""Declaration of the commands for one device: identify, check, simulate, compare, diagnose, refine, demo, effects, paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from . import complete
from .options import (
    CampaignFolder,
    EffectFolders,
    Json,
    LimitsFile,
    LotOrMeasurement,
    Measurement,
    PageFolder,
    PopulationFile,
    Posterior,
    StartModel,
    only_with,
)


def identify(
    measurement: Measurement,
    model: Annotated[Path | None, typer.Option(help="Model file; default: the model of the screening run.")] = None,
    stream: Annotated[
        bool, typer.Option("--stream", help="Follow a record that is being written ('-': stdin).")
    ] = False,
    campaign: Annotated[
        Path | None, typer.Option(help="With --stream: campaign with the instrument and noise.")
    ] = None,
    sigma_v: Annotated[float | None, typer.Option(help="With --stream: noise sd of the sense channels [V].")] = None,
    limits: Annotated[Path | None, typer.Option(help="Limits (TOML) of the gate; with --stream also the rule.")] = None,
    decide: Annotated[bool, typer.Option("--decide", help="With --stream: stop once pass or fail is decided.")] = False,
    json: Json = False,
) -> None:
    """Identify one device: theta, split and the other quantities."""
    if stream:
        from ..stream import stream as follow

        follow(measurement, json, campaign, sigma_v, limits, decide=decide)
        return
    from ..identify import identify as command

    command(measurement, model, limits, json)


def init(
    files: Annotated[list[Path], typer.Argument(help="Record files of one device, all with the same columns.")],
    out: Annotated[Path | None, typer.Option(help="Folder for campaign.toml; default: <first file>-campaign.")] = None,
) -> None:
    """Look at foreign files, write campaign.toml, plot them."""
    from ..init import init as command

    command(files, out)


def check(campaign: CampaignFolder, json: Json = False) -> None:
    """Check a campaign before any fit.

    Prints the TOML lines that correct polarity, channel order, lag and offset.
    """
    from ..identify import check as command

    command(campaign, json)


def simulate(
    out_dir: Annotated[Path, typer.Argument(help="Folder for the campaign.")],
    config: Annotated[Path | None, typer.Option(help="Run configuration with instrument, noise and hum.")] = None,
    device: Annotated[str, typer.Option(help="Plant parameters, for example theta_deg=12,split_hz=1.5.")] = "",
    effect: Annotated[
        list[str] | None,
        typer.Option(help="NAME or NAME:param=value,..; can be repeated.", autocompletion=complete.effects),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the device, the effect sizes and the noise.")] = 1,
    effects: EffectFolders = None,
    lot: Annotated[bool, typer.Option("--lot", help="A measured lot instead of one device.")] = False,
    population: PopulationFile = None,
    irregularity: Annotated[
        list[str] | None,
        typer.Option(
            help="With --lot: NAME or NAME:param=value,..; can be repeated.", autocompletion=complete.irregularities
        ),
    ] = None,
) -> None:
    """Simulate the standard campaign of one virtual device.

    With --lot a measured lot of a population instead. The true parameters are written to truth.json.
    """
    if lot or population is not None or irregularity:
        from ..lot import simulate_lot

        simulate_lot(out_dir, population, irregularity or [], seed)
        return
    from ..model import simulate as command

    command(out_dir, config, device, effect or [], seed, effects or [])


def compare(
    campaign: LotOrMeasurement,
    model: StartModel = None,
    out: PageFolder = None,
    effects: EffectFolders = None,
    limits: LimitsFile = None,
    population: PopulationFile = None,
    posterior: Posterior = None,
    json: Json = False,
) -> None:
    """Fit a model to a campaign and show where it fails."""
    if _for_a_lot("compare", campaign, population, out, limits, json, model, effects, posterior):
        return
    only_with("a lot", {"--posterior": posterior is not None})
    from ..learn import compare as command

    command(campaign, model, out, effects or [], json, limits)


def diagnose(
    campaign: LotOrMeasurement,
    model: StartModel = None,
    out: PageFolder = None,
    effects: EffectFolders = None,
    limits: LimitsFile = None,
    population: PopulationFile = None,
    json: Json = False,
) -> None:
    """Find the physical effect that the model lacks, if any."""
    if _for_a_lot("diagnose", campaign, population, out, limits, json, model, effects):
        return
    from ..learn import diagnose as command

    command(campaign, model, out, effects or [], json, limits)


def refine(
    campaign: LotOrMeasurement,
    model: StartModel = None,
    out: PageFolder = None,
    effects: EffectFolders = None,
    limits: LimitsFile = None,
    population: PopulationFile = None,
    posterior: Posterior = None,
    json: Json = False,
) -> None:
    """Diagnose, add the effect and refit, until none is missing."""
    if _for_a_lot("refine", campaign, population, out, limits, json, model, effects, posterior):
        return
    only_with("a lot", {"--posterior": posterior is not None})
    from ..learn import refine as command

    command(campaign, model, out, effects or [], json, limits)


def _for_a_lot(
    command: Literal["compare", "diagnose", "refine"],
    path: Path,
    population: Path | None,
    out: Path | None,
    limits: Path | None,
    json: bool,
    model: Path | None,
    effects: list[Path] | None,
    posterior: int | None = None,
) -> bool:
    """Whether ``path`` is a lot; it is then answered."""
    if population is None:
        from ...lots.named import is_lot

        if not is_lot(path):
            return False
    from ..lot import answer_lot

    answer_lot(command, path, population, out, limits, json, model, effects, posterior)
    return True


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the page.")] = Path("demo"),
    seed: Annotated[int | None, typer.Option(help="Seed of the device and its effect; default: random.")] = None,
    lot: Annotated[bool, typer.Option("--lot", help="Hide an irregularity in a lot instead.")] = False,
) -> None:
    """Hide an effect in a virtual device and let refine find it."""
    if lot:
        from ..lot import demo_lot

        demo_lot(out, seed)
        return
    from ..learn import demo as command

    command(out, seed)


def effects(
    name: Annotated[
        str | None,
        typer.Argument(help="One effect in full; default: a list of all.", autocompletion=complete.effects),
    ] = None,
    effects: EffectFolders = None,
) -> None:
    """List the effects that a model can contain."""
    from ..model import effects as command

    command(name, effects or [])


def paper(out: Annotated[Path, typer.Option(help="Folder for the page.")] = Path("paper"), json: Json = False) -> None:
    """Reproduce the figures and numbers of the paper on one page."""
    from ..paper import paper as command

    command(out, json)


COMMANDS = (identify, paper, init, check, simulate, compare, diagnose, refine, demo, effects)
