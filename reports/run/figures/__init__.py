"""The figures of a run's page, from its devices and its content: name -> figure, ``None`` if there is nothing to draw."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.axial import difference, mean_axis
from pipeline.quantities import AXES

from ...devices import ColumnSource, Devices, rows_of
from ...html.drawing_process import Ask
from ...html.style import Drawing
from ...limits import Limit
from ...words.quantities import SUPERSCRIPT, UNITS, label, limit_words
from ..calibration import z_scores
from ..content import RunContent
from ..health import ROUTE_THETAS, miss
from ..worst import WorstDevice, WorstEstimate
from .calibration import coverage_dots, z_panels
from .capability import capability_bars
from .causes import CauseBar, StageBar, pareto_bars, stage_bars
from .corners import corner_plot
from .distribution import histograms, theta_and_split
from .risks import risk_curve_figure
from .route import route_scatter
from .wafermap import stacked_map, wafer_maps
from .yields import Span, yield_spans

# The quantities with the strongest posterior correlations after a chirp.
CORNER = {"theta_deg": "Δ theta", "split_hz": "Δ split", "c12_per_s": "Δ c12", "sense_imbalance": "Δ imbal."}


def run_figures(devices: Devices, content: RunContent) -> dict[str, Drawing | None]:
    """All figures of the page by name; ``None`` where there is nothing to draw."""
    return {name: None if ask is None else ask() for name, ask in figures_asked(devices, content).items()}


def figures_asked(devices: Devices, content: RunContent) -> dict[str, Ask | None]:
    """What draws each figure of the page, by name; ``None`` where there is nothing to draw."""
    if not len(devices):
        return {}
    return {
        "yield-spans": partial(yield_spans, _spans(content)),
        "pareto": _pareto(content),
        "stages": _stages(content),
        **_maps(devices),
        **_distributions(devices, content),
        **_calibration(devices, content),
        "route": _route(devices) if content.routes else None,
        "capability": partial(capability_bars, content.capabilities),
        "risk-curve": None
        if content.risk_curve is None
        else partial(risk_curve_figure, content.risk_curve, content.limits.rule),
    }


def corners_asked(worst: Sequence[WorstDevice], posterior: ColumnSource | None) -> tuple[Ask | None, ...]:
    """What draws a corner plot of the first device of each kind of worst; ``None`` for the others and those without draws."""
    first = [device.why not in {other.why for other in worst[:k]} for k, device in enumerate(worst)]
    return tuple(
        _corner(f"corner-{k}", device.device_id, device.estimates, posterior)
        if chosen and posterior is not None
        else None
        for k, (device, chosen) in enumerate(zip(worst, first, strict=True))
    )


def device_corner(
    name: str, device_id: str, estimates: Sequence[WorstEstimate], posterior: ColumnSource
) -> Drawing | None:
    """The corner plot of a device from its draws in ``posterior``; ``None`` where they are too few.

    ``estimates`` gives the truths.
    """
    ask = _corner(name, device_id, estimates, posterior)
    return None if ask is None else ask()


def _corner(name: str, device_id: str, estimates: Sequence[WorstEstimate], posterior: ColumnSource) -> Ask | None:
    # The other columns of all draws of the part need not be read.
    held = [name for name in ("device_id", *CORNER) if name in posterior.column_names]
    rows = Devices(rows_of(posterior.select(held), device_id))
    truths = {estimate.quantity: estimate.truth for estimate in estimates}
    columns: list[FloatArray] = []
    shown: list[float] = []
    labels: list[str] = []
    for quantity, symbol in CORNER.items():
        values, truth = rows.number(quantity), truths.get(quantity, float("nan"))
        if not np.isfinite(values).any():
            continue
        # Relative to the centre and scaled by powers of a thousand: digits that all draws share would crowd the ticks.
        centre = mean_axis(values) if quantity in AXES else float(np.nanmean(values))
        values = difference(values, centre) if quantity in AXES else values - centre
        truth = float(difference(truth, centre)) if quantity in AXES else truth - centre
        exponent = _thousands(float(np.nanstd(values)))
        columns.append(values / 10.0**exponent)
        shown.append(truth / 10.0**exponent)
        labels.append(f"{symbol}\n{_unit(exponent, UNITS[quantity])}")
    if not columns:
        return None
    return partial(corner_plot, labels, np.stack(columns, axis=1), shown, name, f"Posterior of {device_id}")


def _thousands(sd: float) -> int:
    """Power of ten, a multiple of three, that scales the sd to between 0.2 and 200."""
    return 3 * int(np.floor((np.log10(sd) + 0.7) / 3.0)) if sd > 0.0 else 0


def _unit(exponent: int, unit: str) -> str:
    power = f"10{str(exponent).translate(SUPERSCRIPT)}" if exponent else ""
    return f"{power} {unit}".strip() or "1"


def _spans(content: RunContent) -> list[Span]:
    total, n = content.total, content.total.devices
    share = content.measurement
    spans = [
        Span(
            "Which of these devices conform?",
            "measurement (Poisson-binomial)",
            share.low / n,
            share.mean / n,
            share.high / n,
        ),
        Span(
            "Which of these devices conform?",
            "undecided: all fail to all pass",
            total.bounds[0],
            total.value,
            total.bounds[1],
        ),
        Span(
            "What would more devices like these yield?",
            "sampling (Clopper-Pearson)",
            total.clopper_pearson.low,
            total.value,
            total.clopper_pearson.high,
        ),
        Span(
            "What would more devices like these yield?",
            "sampling (Wilson)",
            total.wilson.low,
            total.value,
            total.wilson.high,
        ),
        Span(
            "What would more devices like these yield?",
            "sampling, undecided either way",
            total.envelope.low,
            total.value,
            total.envelope.high,
        ),
    ]
    for one in content.clusters:
        if one.interval is not None:
            spans.append(
                Span(
                    "What would the process yield?",
                    f"{one.groups} {one.by}s as draws",
                    one.interval.low,
                    total.value,
                    one.interval.high,
                )
            )
    return spans


def _pareto(content: RunContent) -> Ask | None:
    if not content.pareto.failed:
        return None
    bars = [
        CauseBar(f"{label(row.limit.quantity)} {limit_words(row.limit)}", row.failed, row.alone)
        for row in content.pareto.limits
    ]
    return partial(pareto_bars, bars, content.pareto.failed)


def _stages(content: RunContent) -> Ask | None:
    if not content.stages:
        return None
    bars = [
        StageBar(
            f"{label(row.limit.quantity)} {limit_words(row.limit)}" if row.limit else "all limits together",
            row.fabrication,
            row.packaging,
            row.recovered,
        )
        for row in content.stages
    ]
    return partial(stage_bars, [bars[0], *sorted(bars[1:], key=lambda bar: -(bar.fabrication + bar.packaging))])


def _maps(devices: Devices) -> dict[str, Ask | None]:
    x, y, wafers = devices.number("die_x_mm"), devices.number("die_y_mm"), devices.wafers()
    placed = np.isfinite(x) & np.isfinite(y) & ~wafers.equals("")
    if not placed.any():
        return {"wafer-maps": None, "stacked-map": None}
    verdicts = devices.text("verdict")
    return {
        "wafer-maps": partial(wafer_maps, x[placed], y[placed], verdicts.at(placed), wafers.at(placed)),
        "stacked-map": partial(stacked_map, x[placed], y[placed], devices.has("pass")[placed]),
    }


def _distributions(devices: Devices, content: RunContent) -> dict[str, Ask | None]:
    limits: dict[str, Limit] = {limit.quantity: limit for limit in content.limits.limits}
    verdicts = devices.text("verdict")
    others = [name for name in limits if name not in ("theta_deg", "split_hz")]
    panels = [
        (label(name) + (f", {UNITS[name]}" if UNITS[name] else ""), devices.number(name), limits[name])
        for name in others
    ]
    return {
        "theta-split": partial(
            theta_and_split,
            devices.number("theta_deg"),
            devices.number("split_hz"),
            verdicts,
            limits.get("theta_deg"),
            limits.get("split_hz"),
        ),
        "histograms": partial(histograms, panels, verdicts) if panels else None,
    }


def _calibration(devices: Devices, content: RunContent) -> dict[str, Ask | None]:
    if not content.coverages:
        return {"coverage": None, "z-scores": None}
    panels = [(label(name), z_scores(devices, name)) for name in ("theta_deg", "split_hz")]
    return {
        "coverage": partial(coverage_dots, [(label(row.quantity), row) for row in content.coverages]),
        "z-scores": partial(z_panels, panels),
    }


def _route(devices: Devices) -> Ask:
    virtual = bool(np.isfinite(devices.number("true_split_hz")).any())
    against = "true_" if virtual else ""
    of = "error" if virtual else "difference"
    thetas = np.stack([miss(devices, name, f"{against}theta_deg") for name in ROUTE_THETAS])
    known = np.isfinite(thetas).any(axis=0)
    worst = np.full(len(devices), np.nan)
    worst[known] = np.nanmax(thetas[:, known], axis=0)
    theta_posterior = miss(devices, "theta_deg", "true_theta_deg") if virtual else None
    split_posterior = miss(devices, "split_hz", "true_split_hz") if virtual else None
    return partial(
        route_scatter,
        devices.number(f"{against}split_hz"),
        [
            (f"largest {of} of the four thetas, deg", worst, theta_posterior),
            (f"{of} of the split, Hz", miss(devices, "arx_split_hz", f"{against}split_hz"), split_posterior),
        ],
    )
