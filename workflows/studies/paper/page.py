"""``gyroscreen paper``: every number and figure of the paper, computed and laid out as one page."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.errors import unwritable
from pipeline.experiment.antialias import filter_response
from pipeline.identification.phase import correct_phase, correct_phase_hinf
from pipeline.identification.reduction import Reduction, reduce_model
from pipeline.identification.route import RouteResult, identify_record
from reports.paper.content import ChainRow, HankelView, PaperContent
from reports.paper.page import render_paper

from . import devices as study
from . import numbers, tables

PAGE = "paper.html"


def _chain(physical: FloatArray, reduction: Reduction, fit: dict[str, float]) -> tuple[ChainRow, ...]:
    truth = dict(zip(PHYSICAL, physical.tolist())) | {"split_hz": float(physical[1] - physical[0])}

    def of(route: RouteResult) -> dict[str, float]:
        found = {f"f{k + 1}_hz": float(route.f_hz[k]) for k in range(3)}
        found |= {f"zeta{k + 1}": float(route.zeta[k]) for k in range(3)}
        found |= {"theta_deg": route.axes.mean_deg, "split_hz": route.arx_split_hz}
        gains = route.gains
        return found | {"sense_imbalance": gains.sense_imbalance, "drive_imbalance": gains.drive_imbalance}

    balanced, modal = of(reduction.balanced), of(reduction.modal)
    rows = (
        ("theta_deg", "θ", "deg"), ("split_hz", "split", "Hz"), ("f1_hz", "f1", "Hz"), ("f2_hz", "f2", "Hz"),
        ("f3_hz", "f3", "Hz"), ("zeta1", "ζ1", ""), ("zeta2", "ζ2", ""), ("zeta3", "ζ3", ""),
        ("sense_imbalance", "sense imbalance", ""), ("drive_imbalance", "drive imbalance", ""),
    )  # fmt: skip
    return tuple(
        ChainRow(name, unit, truth[q], balanced[q], modal[q], fit[q], fit[f"{q}_sd"]) for q, name, unit in rows
    )


def paper_content(sizes: study.StudySizes, say: Callable[[str], None] = lambda _: None) -> PaperContent:
    """Compute everything on the page.

    Parameters
    ----------
    sizes : size of the convergence study, of the study of one step against two, and number of noise records.
    say : called with a short description before each part.
    """
    say("eq. (14) and (15)")
    eq14 = numbers.printed_device()
    physical = study.paper_physical(eq14)
    say("identification of records of eq. (14)")
    again = [study.eq14_record(eq14, seed) for seed in range(sizes.noises)]
    closing = reduce_model(study.lattice_model(again[0]), study.INSTRUMENT)
    found = closing.modal
    others = [identify_record(record, study.INSTRUMENT, study.ORDER) for record in again[1:]]
    of = numbers.sources(eq14, [found, *others])
    hankel14 = numbers.hankel_of(eq14.modes)
    say("the record of figure 4 and its models")
    record, sigma_v = study.paper_record(physical)
    began = time.perf_counter()
    model = study.lattice_model(record)
    lattice_s = time.perf_counter() - began
    reduction = reduce_model(model, study.INSTRUMENT)
    batch = identify_record(record, study.INSTRUMENT, study.ORDER)
    say("the tables of section 5")
    groups = {
        "hankel": numbers.hankel_numbers(hankel14, closing),
        "model": numbers.model_numbers(of),
        "frequencies": numbers.frequency_numbers(found),
        "markov": numbers.markov_numbers(of),
        "gains": numbers.gain_numbers(of),
        "theta": numbers.theta_numbers(of),
        "table1": tables.table1_numbers(eq14),
        "table2": tables.table2_numbers(eq14),
    }
    say("convergence with the order")
    orders = study.order_view(record, physical, sizes.orders)
    say("one step against two")
    steps = study.steps_view(physical, np.array(sizes.splits_hz), np.array(sizes.shares))
    say("phase correction, frequency responses and rate biases")
    projected = correct_phase(eq14.modes, eq14.record.antialias)
    hinf = correct_phase_hinf(eq14.modes, eq14.record.antialias)
    gain = filter_response(eq14.record.antialias, np.array([1j * np.abs(eq14.modes.poles[0])]))
    responses = study.response_view(model, reduction.modal.filtered, eq14)
    whole, six, *_ = responses.narrow.values()
    band_error = float(np.max(np.linalg.norm(whole - six, ord=2, axis=(1, 2))))
    printed = np.array([float(v) for v in numbers.HANKEL])
    return PaperContent(
        groups,
        study.record_view(record, physical),
        responses,
        HankelView(reduction.hankel, hankel14, printed, reduction.error_bound, band_error),
        orders,
        steps,
        _chain(physical, reduction, study.fit_record(record, sigma_v)),
        {
            "printed": np.array([float(v) for v in numbers.THETAS]),
            "from eq. (14)": eq14.route.axes.theta_deg,
            "from a record of eq. (14)": found.axes.theta_deg,
        },
        study.bias_rows(physical),
        float(np.max(np.abs(reduction.modal.axes.theta_deg - batch.axes.theta_deg))),
        lattice_s,
        float(np.angle(gain[0], deg=True)),
        float(np.max(np.abs(hinf - projected)) / np.max(np.abs(hinf))),
    )


def write_paper(
    out: Path, sizes: study.StudySizes | None = None, say: Callable[[str], None] = lambda _: None
) -> tuple[Path, PaperContent, float]:
    """Write the page into the folder ``out``; returns its path, its content, and the run time [s].

    Raises
    ------
    UsageError : the folder cannot be written.
    """
    began = time.monotonic()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable("the page", out, error, "choose another --out") from error
    with threadpool_limits(limits=1):
        content = paper_content(sizes or study.StudySizes(), say)
    path = out / PAGE
    try:
        path.write_text(render_paper(content), encoding="utf-8")
    except OSError as error:
        raise unwritable("the page", path, error, "choose another --out") from error
    return path, content, time.monotonic() - began
