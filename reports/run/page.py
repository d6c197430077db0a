"""The page of a run: one self-contained HTML file that opens offline.

tables, limits --content--> RunContent --figures, templates--> HTML
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from pipeline.learning.lot.origin_answers import LotOriginAnswers
from pipeline.quantities import QUANTITIES

from ..attribution.content import Attribution
from ..capability import Common
from ..devices import Devices, wafer_name
from ..html.drawing_process import DrawingProcess, drawn
from ..html.rendering import environment, interval, measured, stylesheet
from ..limits import Limits
from ..limits_origin import LimitsOrigin
from ..words.capability import index_words, no_index, share_words
from ..words.limits import origin_sentence
from ..words.lot_origin import ON_PAGE, departure_words, drift_sentence, lot_origin_sentence, p_words
from ..words.noise import lot_noise_sentence
from ..words.physics import RunPhysics, physics_sentences
from .content import ReportedRun, RunContent, run_content
from .figures import corners_asked, figures_asked
from .lot_effects import LotEffects, counted, probability, with_sd
from .sources import loss_sources
from .worst import WorstEstimate

MOST_GROUPS = 60

_DIAGNOSTICS = {
    "error": "error (rms residual / sigma)",
    "error_all_noise": "error, noise that depends on the signal included",
    "chi2_per_dof": "chi2 per degree of freedom",
    "relative_error": "relative error",
    "theta_bias_bound_deg": "bound on the bias of theta from the excess of chi2, deg",
    "effect_p_value": "p-value of the most significant effect of the library",
    "rhat": "R-hat between ensembles",
    "ess": "effective sample size",
    "acceptance": "acceptance",
}
_ROUTE = {
    "theta_u1_deg": "theta from u1",
    "theta_v1_deg": "theta from v1",
    "theta_u2_deg": "theta from u2",
    "theta_v2_deg": "theta from v2",
    "theta_deg": "theta, posterior",
    "arx_split_hz": "split, ARX",
    "split_hz": "split, posterior",
}


def render_run_report(
    run: ReportedRun,
    limits: Limits,
    *,
    population_summary: Mapping[str, Any] | None = None,
    lot_effects: LotEffects | None = None,
    physics: RunPhysics | None = None,
    common: Common = MappingProxyType({}),
    limits_origin: LimitsOrigin | None = None,
    attribution: Attribution | None = None,
    origin: LotOriginAnswers | None = None,
    beside: DrawingProcess | None = None,
) -> str:
    """The page of a run as HTML text; the same input gives the same page.

    Parameters
    ----------
    run : tables in the registered schema, manifest and configuration; there may be no devices, and null columns.
    limits : the limits and rule by which the run was judged.
    population_summary : description of the population; nested tables become dotted names.
    lot_effects : findings about its misfits.
    physics : what its devices and its model contain, stated at the head of the page.
    common : quantity -> (E, B) shift by one sd of each error that all devices share.
    limits_origin : where the limits came from.
    attribution : where the loss comes from; ``None`` leaves the section out.
    origin : whether the lot comes from the population for screening; ``None`` likewise.
    beside : a second process that draws some of its figures.

    Raises
    ------
    ConfigError : the limits name a quantity that is not in the results.
    """
    content = run_content(run, limits, population_summary, lot_effects, common)
    devices = Devices(run.devices)
    figures, corners = figures_asked(devices, content), corners_asked(content.worst, run.posterior)
    asked = [*figures.values(), *corners]
    pictures = iter(drawn([ask for ask in asked if ask is not None], beside))
    shown = [None if ask is None else next(pictures) for ask in asked]
    page = environment().get_template("run.html.j2")
    return page.render(
        c=content,
        stylesheet=stylesheet(),
        figures=dict(zip(figures, shown)),
        corners=shown[len(figures) :],
        sections=_sections(content, attribution is not None, origin is not None),
        origin=origin,
        lot_origin_sentence=lot_origin_sentence,
        drift_sentence=drift_sentence,
        departure_words=departure_words,
        p_words=p_words,
        most_departures=ON_PAGE,
        sources=None if attribution is None else loss_sources(attribution),
        limits_origin="" if limits_origin is None else origin_sentence(limits_origin),
        physics=(*(() if physics is None else physics_sentences(physics)), *_noise(devices)),
        diagnostics=_DIAGNOSTICS,
        route_names=_ROUTE,
        meanings={quantity.name: quantity.meaning for quantity in QUANTITIES},
        most_groups=MOST_GROUPS,
        most_maps=12,
        with_estimate=int(np.sum(np.isfinite(devices.number("theta_deg")))),
        interval=interval,
        wafer_name=wafer_name,
        truth_of=_truth,
        probability=probability,
        counted=counted,
        with_sd=with_sd,
        index_words=index_words,
        no_index=no_index,
        share=share_words,
    )


def _noise(devices: Devices) -> tuple[str, ...]:
    jitter, gain = (devices.number(name) for name in ("jitter_s", "gain_noise"))
    shown = [values[np.isfinite(values)] for values in (jitter, gain)]
    found = lot_noise_sentence(devices.text("noise_colour"), *shown)
    return (found,) if found else ()


def _truth(estimate: WorstEstimate) -> str:
    """The true value, with the decimals of the estimate."""
    return measured(estimate.truth, estimate.sd).partition(" ±")[0]


def _sections(content: RunContent, sources: bool, origin: bool) -> tuple[tuple[str, str], ...]:
    return tuple(
        (key, name)
        for key, name, there in (
            ("causes", "Causes of loss", content.identified),
            ("sources", "Where the loss comes from", content.identified and sources),
            ("yield", "Yield", content.identified),
            ("wafers", "Wafers", content.identified and bool(content.wafers)),
            ("distributions", "Theta and split", content.identified),
            ("capability", "Capability", bool(content.capabilities)),
            ("risks", "Risks", bool(content.risks)),
            ("lot-origin", "Where this lot comes from", origin),
            ("lot-effects", "Effects this lot needs", content.needed is not None),
            ("trim", "Electronic tuning", content.trim is not None),
            ("calibration", "Calibration", True),
            ("health", "Convergence", True),
            ("bias-bounds", "Undetected effects", bool(content.bias_bounds)),
            ("route", "The paper's route", bool(content.routes)),
            ("worst", "Worst devices", True),
            ("limits", "Limits", True),
            ("provenance", "Provenance", True),
        )
        if there
    )
