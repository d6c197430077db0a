"""Every figure of the pages as a matplotlib ``Figure``; see :mod:`workflows.api`.

    gs.figures.wafer_maps(night)                one figure of a night's report
    gs.figures.ladder(gs.refine(campaign))      one figure of the page of compare, diagnose or refine
    gs.figures.all_of(night)                    all figures of a page by name

The figures belong to no pyplot state, so nothing has to be closed; ``save`` writes one to a file, and a notebook shows them after
``%matplotlib inline``.  Units are on the axes.  All functions raise ``UsageError`` where there is nothing to draw.
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from pipeline.errors import UsageError
from pipeline.experiment.record import Campaign
from pipeline.experiment.tones import ToneCampaign
from reports.devices import Devices
from reports.html.style import Drawing
from reports.learning.figures.amplitudes import amplitudes_figure
from reports.learning.figures.columns import columns_figure
from reports.learning.figures.decays import decay_pictures
from reports.learning.figures.ladder import four_thetas_plot, ladder_plot, residue_plot
from reports.learning.figures.records import Picture, record_figures
from reports.learning.figures.tones import tone_pictures, tones_figure
from reports.learning.page import modes_of
from reports.run.figures import device_corner, run_figures
from reports.run.worst import device_estimates

from ..device.measured import Measured
from ..learning import Result
from ..learning.views import PageViews, views_of
from ..lots.page import lot_drawings
from ..lots.results import LotResult
from ..studies.paper.devices import StudySizes
from .night import ScreeningRun


def all_of(shown: ScreeningRun | Result | LotResult) -> dict[str, Figure]:
    """All figures of the page of a run, or of an answer of compare, diagnose or refine, by name."""
    return {name: drawing.figure for name, drawing in _drawings(shown).items()}


def yield_spans(run: ScreeningRun) -> Figure:
    """Intervals of the yield [%] by source of uncertainty."""
    return _one(run, "yield-spans")


def pareto(run: ScreeningRun) -> Figure:
    """Failed devices by limit."""
    return _one(run, "pareto")


def stages(run: ScreeningRun) -> Figure:
    """Devices lost in fabrication and in packaging, by limit; virtual devices only."""
    return _one(run, "stages")


def wafer_maps(run: ScreeningRun) -> Figure:
    """Verdicts at the die positions of each wafer, at most twelve."""
    return _one(run, "wafer-maps")


def stacked_map(run: ScreeningRun) -> Figure:
    """Share of passing devices by die position and by radius, all wafers on one."""
    return _one(run, "stacked-map")


def theta_and_split(run: ScreeningRun) -> Figure:
    """Distributions of theta and of the split, with limits, by verdict."""
    return _one(run, "theta-split")


def histograms(run: ScreeningRun) -> Figure:
    """Distributions of the other limited quantities, with limits, by verdict."""
    return _one(run, "histograms")


def coverage(run: ScreeningRun) -> Figure:
    """Coverage of the 90 % intervals by quantity; virtual devices only."""
    return _one(run, "coverage")


def z_scores(run: ScreeningRun) -> Figure:
    """(estimate - truth)/sd of theta and split against the standard normal; virtual devices only."""
    return _one(run, "z-scores")


def route(run: ScreeningRun) -> Figure:
    """Error of the paper's route and of the posterior against the split."""
    return _one(run, "route")


def corner(run: ScreeningRun, device_id: str) -> Figure:
    """Marginals of the posterior draws of a device, relative to their centre; the truth where it is known.

    Raises
    ------
    UsageError : no such device, or too few draws of it.
    """
    truths = run.read(lambda tables: device_estimates(Devices(tables.devices), run.limits, device_id))
    drawing = run.read(lambda tables: device_corner(f"corner-{device_id}", device_id, truths, tables.posterior))
    if drawing is None:
        raise _nothing(f"corner of {device_id}", "a device with at least 20 draws in the run")
    return drawing.figure


def ladder(result: Result) -> Figure:
    """Error and misfit of each model of the ladder, on fitted and on held-out records; of refine."""
    return _one(result, "ladder")


def residues(result: Result) -> Figure:
    """Residues of each mode of a modal record in the complex plane, measured and modelled."""
    return _one(result, "residues")


def four_thetas(result: Result) -> Figure:
    """The four estimates of theta of the paper's route and the fit's, for every model of the ladder of a modal record."""
    return _one(result, "four-thetas")


def level(result: Result) -> Figure:
    """Residual [sigma] against the level of the response [V rms]."""
    return _one(result, "level")


def channel_errors(result: Result) -> Figure:
    """Error of every record and channel."""
    return _one(result, "channel-errors")


def resonance(result: Result, number: int = 0) -> Figure:
    """Measured, model and residual spectra around a resonance; ``number`` counts the pictures of the page."""
    return _one(result, f"resonance-{number}")


def spectrogram(result: Result, number: int = 0) -> Figure:
    """Residual over time and frequency [sigma] of a record; ``number`` counts the pictures of the page."""
    return _one(result, f"spectrogram-{number}")


def decay(result: Result, number: int = 0) -> Figure:
    """Frequency and damping ratio of the pieces of a free decay against amplitude."""
    return _one(result, f"decay-{number}")


def tone(result: Result, number: int = 0) -> Figure:
    """Measured response, model and residual of a sweep or frequency response, with the Nyquist plane."""
    return _one(result, f"tone-{number}")


def forecast(result: LotResult) -> Figure:
    """Yield of the held-out wafers [%], forecast and measured, and their log score, for each model of the ladder of a lot."""
    return _one(result, "forecast")


def spreads(result: LotResult) -> Figure:
    """Fitted spreads over those of the population file, with 90 % intervals."""
    return _one(result, "spreads")


def residual_maps(result: LotResult, after: bool = False) -> Figure:
    """Mean residual of all wafers of a lot at each place [sd of the mean], of the given or of the last population."""
    return _one(result, "maps-after" if after else "maps-before")


def channels(campaign: Measured) -> Figure:
    """What was read: channels of the first records against time and frequency; sweeps and responses against frequency.

    Amplitudes of free decays are drawn where a campaign has nothing else.
    """
    if isinstance(campaign, Campaign):
        return columns_figure(campaign.records)
    if isinstance(campaign, ToneCampaign) and campaign.records:
        return tones_figure(campaign.records)
    if isinstance(campaign, ToneCampaign) and (campaign.timed or campaign.envelopes):
        return columns_figure(campaign.timed.records) if campaign.timed else amplitudes_figure(campaign.envelopes)
    raise _nothing("channels", "a campaign: a modal record has no channels")


def paper(sizes: StudySizes | None = None) -> dict[str, Figure]:
    """The figures of the paper, recomputed, by name: figure-4, figure-5, figure-6, hankel, thetas, orders, steps.

    ``sizes``: how much is computed; by default what ``gyroscreen paper`` computes, which takes a minute.
    """
    from reports.paper.page import paper_figures

    from ..studies.paper.page import paper_content

    with threadpool_limits(limits=1):
        content = paper_content(sizes or StudySizes())
    return {name: drawing.figure for name, drawing in paper_figures(content).items()}


def save(figure: Figure, path: str | Path, dpi: float = 150.0) -> Path:
    """Write a figure to a file; the suffix chooses the format (png, svg, pdf).

    Raises
    ------
    UsageError : the file cannot be written, or an unknown suffix.
    """
    allowed = sorted(figure.canvas.get_supported_filetypes())
    if Path(path).suffix.removeprefix(".") not in allowed:
        raise UsageError("unknown format of a figure", value=str(path), allowed=", ".join(allowed))
    try:
        figure.savefig(path, dpi=dpi)
    except OSError as error:
        raise UsageError(f"the figure cannot be written ({error.strerror})", value=str(path)) from None
    return Path(path)


def _one(shown: ScreeningRun | Result | LotResult, name: str) -> Figure:
    drawings = _drawings(shown)
    if name not in drawings:
        raise _nothing(name, ", ".join(drawings) or "none: there are no devices or no fit")
    return drawings[name].figure


def _nothing(name: str, allowed: str) -> UsageError:
    return UsageError("there is nothing to draw", value=name, allowed=allowed, next_step="gs.figures.all_of lists them")


def _drawings(shown: ScreeningRun | Result | LotResult) -> dict[str, Drawing]:
    if isinstance(shown, LotResult):
        found = lot_drawings(shown.command, shown.answers)
    elif isinstance(shown, ScreeningRun):
        content = shown.content
        found = shown.read(lambda tables: run_figures(Devices(tables.devices), content))
    else:
        found = _of_views(views_of(shown))
    return {name: drawing for name, drawing in found.items() if drawing is not None}


def _of_views(views: PageViews) -> dict[str, Drawing | None]:
    refinement = views.refinement
    rungs = refinement.ladder if refinement else ()
    last = len(rungs) > 1
    parameters = (refinement.parameters if refinement else None) or views.comparison.parameters or {}
    fitted = {name: value for name, (value, _) in parameters.items() if value is not None}
    refused = [name for name in refinement.refused if name not in refinement.not_refitted] if refinement else []
    after = views.after if last else None
    records = record_figures(views.before, after, fitted)
    pictures = {
        "resonance": records.resonances,
        "spectrogram": records.spectrograms,
        "decay": decay_pictures(views.before, after, modes_of(fitted)),
        "tone": tone_pictures(views.tones, views.tones_after if last else ()),
    }
    return {
        "ladder": ladder_plot(rungs, refused),
        "residues": residue_plot(views.comparison.where, (refinement.where or ()) if refinement else ()),
        "four-thetas": four_thetas_plot(rungs),
        "level": records.level,
        "channel-errors": records.channels,
        **{name: drawing for kind, found in pictures.items() for name, drawing in _numbered(kind, found).items()},
    }


def _numbered(kind: str, pictures: tuple[Picture, ...]) -> dict[str, Drawing | None]:
    return {f"{kind}-{k}": picture.drawing for k, picture in enumerate(pictures)}
