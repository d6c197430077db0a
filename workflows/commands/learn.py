"""gyroscreen compare, diagnose, refine, demo."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from pipeline.criticism.announce import announce
from pipeline.device.effect import find_effects
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model, load_model
from pipeline.errors import NegativeError, printable_lines
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.learning.answers import ComparisonAnswer, DiagnosisAnswer, RefinementAnswer, to_json

from ..ahead import compiled_ahead
from ..device.measured import Measured
from ..learning import ComparisonResult, DiagnosisResult, RefinementResult, Result, SelectionResult
from ..learning import compare as compare_measurement
from ..learning import diagnose as diagnose_measurement
from ..learning import refine as refine_measurement
from ..learning.progress import working

if TYPE_CHECKING:
    from reports.limits import Limits
    from reports.limits_origin import LimitsOrigin

PAGES: dict[type[Result], str] = {
    ComparisonResult: "compare.html",
    DiagnosisResult: "diagnose.html",
    RefinementResult: "ladder.html",
}


def compare(
    path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool, limits: Path | None
) -> None:
    """See ``gyroscreen compare --help``."""
    _answer(compare_measurement, path, model, out, folders, json, limits)


def diagnose(
    path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool, limits: Path | None
) -> None:
    """See ``gyroscreen diagnose --help``."""
    with compiled_ahead():
        _answer(diagnose_measurement, path, model, out, folders, json, limits)


def refine(
    path: Path, model: Path | None, out: Path | None, folders: Sequence[Path], json: bool, limits: Path | None
) -> None:
    """See ``gyroscreen refine --help``."""
    with compiled_ahead():
        _answer(refine_measurement, path, model, out, folders, json, limits)


@threadpool_limits.wrap(limits=1)
def _answer(
    command: Callable[[Measured, Model, Limits | None], Result],
    path: Path,
    model: Path | None,
    out: Path | None,
    folders: Sequence[Path],
    json: bool,
    limits_file: Path | None,
) -> None:
    """Read the measurement, run ``command`` on it, write drive files and the page where ``out`` is given, and print."""
    limits, origin = (None, None) if limits_file is None else _stated(limits_file)
    measured = read_measurement(path)
    page = None
    with working(command.__name__, quiet=json):
        found = command(measured, start_model(model, folders), limits)
        if out is not None:
            if isinstance(found, SelectionResult):
                found = found.with_drive_files(out)
            if _has_fit(found):
                announce("drawing the page")
                page = _written(_page(measured, found, folders, origin), found, out)
        # Records that separate classes are looked for when the answer is first asked for.
        _ = found.answer
    print(to_json(found.answer) if json else printable_lines(str(found)))
    if page is not None and not json:
        print(page)
    _require_positive(found.answer)


def _stated(limits_file: Path) -> tuple[Limits, LimitsOrigin]:
    # Only a verdict needs the packages that know the result quantities.
    from reports.limits import load_limits
    from reports.limits_origin import origin_of_file

    return load_limits(limits_file), origin_of_file(limits_file, "command line")


def _require_positive(answer: ComparisonAnswer | DiagnosisAnswer | RefinementAnswer) -> None:
    """Raise NegativeError where the fit of compare failed, or refine ends with a failed fit or an unknown misfit."""
    failed = (isinstance(answer, ComparisonAnswer) and not answer.fit_ok) or (
        isinstance(answer, RefinementAnswer) and answer.verdict == "fit_failed"
    )
    if failed:
        raise NegativeError(
            "the fit failed" + (f" ({answer.why})" if answer.why else ""),
            next_step="gyroscreen check the campaign, or start from another --model",
        )
    if isinstance(answer, RefinementAnswer) and answer.verdict == "unknown":
        raise NegativeError(
            "the missing effect could not be named"
            if answer.imitating
            else "a misfit remains that no effect of the library explains",
            value=answer.verdict,
            allowed="adequate or class",
            next_step="see where it lies with --out FOLDER; try effects of your own with --effects FOLDER",
        )


def start_model(path: Path | None, folders: Sequence[Path]) -> Model:
    """The model of a file, or the paper's, with the user's folders of effects."""
    model = load_model(path) if path is not None else DEFAULT_COMPARE_MODEL
    known = dict.fromkeys((*model.effect_folders, *(str(folder) for folder in folders)))
    return replace(model, effect_folders=tuple(known))


def _has_fit(found: Result) -> bool:
    answer = found.answer
    if isinstance(answer, ComparisonAnswer):
        return answer.fit_ok or bool(answer.error)
    return answer.verdict != "fit_failed"


def _written(page: str, found: Result, out: Path) -> Path:
    # Only a page needs the packages that store results.
    from ..stored_page import written_page

    return written_page(page, out / PAGES[type(found)], "choose another folder with --out")


def _page(
    measured: Measured,
    found: Result,
    folders: Sequence[Path],
    limits: LimitsOrigin | None = None,
    truth: str | None = None,
) -> str:
    # Drawing takes a second to load; a command without a page does not wait for it.
    from reports.learning.page import render_learning_page

    from ..learning.views import views_of

    views = views_of(found)
    return render_learning_page(
        measured.name if isinstance(measured, ModalRecord) else measured.device_id,
        views.comparison,
        views.diagnosis,
        views.refinement,
        before=views.before,
        after=views.after,
        tones=views.tones,
        tones_after=views.tones_after,
        library=find_effects(tuple(folders)),
        limits=limits,
        truth=truth,
    )


@threadpool_limits.wrap(limits=1)
def demo(out: Path, seed: int | None) -> None:
    """See ``gyroscreen demo --help``."""
    from ..learning.demo import hidden_device

    start = time.monotonic()
    chosen = int(time.time()) % 100_000 if seed is None else seed
    made = hidden_device(chosen)
    print(f"a virtual device with a hidden effect was measured (seed {chosen}); searching ...", file=sys.stderr)
    with working("demo", quiet=False):
        found = refine_measurement(made.campaign)
        _ = found.answer
    print(found)
    hidden = ", ".join(f"{k} = {v:.4g}" for k, v in made.parameters.items() if k not in DEFAULT_COMPARE_MODEL.by_name)
    truth = f"{', '.join(made.model.effects)} ({hidden})"
    print(f"the truth: {truth}")
    page = _written(_page(made.campaign, found, (), truth=truth), found, out)
    print(f"{page}  ({time.monotonic() - start:.0f} s)")
