"""gyroscreen compare, diagnose, refine, simulate and demo for a measured lot, and the study of hidden irregularities."""

from __future__ import annotations

import json as json_
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from msgspec import structs

from pipeline.errors import NegativeError, UsageError, printable_lines
from pipeline.learning.answers import to_builtins
from pipeline.learning.lot.answers import LotComparisonAnswer, LotDiagnosisAnswer, LotRefinementAnswer
from pipeline.learning.lot.posterior import MOST, LotPosteriorAnswer
from populations.spec import PopulationSpec, load_spec
from reports.limits import DEFAULT_LIMITS, load_limits
from reports.limits_origin import LimitsOrigin, origin_of_file
from reports.words.lot import lot_lines
from reports.words.lot_posterior import posterior_lines

from ..learning.progress import working
from ..lots.loop import LotAnswers, lot_answers
from ..lots.measured import read_measured_lot
from ..stored_page import written_page

Command = Literal["compare", "diagnose", "refine"]
#: Names of populations that are shipped.
SHIPPED = "cloverleaf"
#: The refined population, beside the page.
POPULATION = "population.toml"


def answer_lot(
    command: Command,
    path: Path,
    population: Path | None,
    out: Path | None,
    limits: Path | None,
    json: bool,
    model: Path | None,
    effects: Sequence[Path] | None = None,
    posterior: int | None = None,
) -> None:
    """See ``gyroscreen compare --help``, with a lot."""
    _check_posterior(posterior)
    if model is not None:
        raise UsageError(
            "a lot has no model file", value=str(model), allowed="--population", next_step="leave --model out"
        )
    if effects:
        raise UsageError(
            "a lot has irregularities instead of effects",
            value=str(effects[0]),
            allowed="irregularity_folders in the population file",
            next_step="leave --effects out",
        )
    table = read_measured_lot(path)
    judged = DEFAULT_LIMITS if limits is None else load_limits(limits)
    answers = lot_answers(table, start_population(population), judged)
    with working(command, quiet=json):
        found = _found(command, answers)
        sampled = None if posterior is None else answers.posterior(command, posterior)
        # Another product than a gyro is judged by the limits of its lot.toml.
        origin = None if limits is None or not table.gyro else origin_of_file(limits, "command line")
        page = None if out is None else _written(command, answers, out, origin, sampled)
    if isinstance(found, LotRefinementAnswer) and out is not None and answers.spec is not None:
        found = structs.replace(found, population_file=str(out / POPULATION))
    if json:
        more = {} if sampled is None else {"posterior": to_builtins(sampled)}
        print(json_.dumps(to_builtins(found) | more))
    else:
        print(printable_lines("\n".join([*lot_lines(found), *([] if sampled is None else posterior_lines(sampled))])))
        if page is not None:
            print(page)
    _require_positive(found)


def _check_posterior(count: int | None) -> None:
    if count is not None and not 1 <= count <= MOST:
        raise UsageError(
            "--posterior is no number of spreads that can be sampled together",
            value=count,
            allowed=f"1 to {MOST}",
            next_step="correct --posterior",
        )


def start_population(path: Path | None) -> PopulationSpec | None:
    """The population of a file; ``None`` without one."""
    if path is None or (str(path) == SHIPPED and not path.exists()):
        return None if path is None else load_spec(None)
    return load_spec(path)


def _found(command: Command, answers: LotAnswers) -> LotComparisonAnswer | LotDiagnosisAnswer | LotRefinementAnswer:
    if command == "compare":
        return answers.comparison
    return answers.diagnosis if command == "diagnose" else answers.refinement


def _written(
    command: Command,
    answers: LotAnswers,
    out: Path,
    limits: LimitsOrigin | None = None,
    posterior: LotPosteriorAnswer | None = None,
    truth: str | None = None,
) -> Path:
    """The page, and of refine the refined population file."""
    # Drawing takes a second to load; a command without a page does not wait for it.
    from ..lots.page import lot_page

    path = out / ("ladder.html" if command == "refine" else f"{command}.html")
    other = "choose another folder with --out"
    written_page(lot_page(command, answers, limits, truth, posterior), path, other)
    refined = answers.refined_population if command == "refine" else None
    if refined is not None:
        written_page(refined.to_toml(), out / POPULATION, other, "the population file")
    return path


def _require_positive(found: LotComparisonAnswer | LotDiagnosisAnswer | LotRefinementAnswer) -> None:
    """Raise NegativeError where a fit failed, or refine ends with an unknown misfit."""
    failed = (isinstance(found, LotComparisonAnswer) and not found.fit_ok) or (
        isinstance(found, LotRefinementAnswer) and found.verdict == "fit_failed"
    )
    if failed:
        raise NegativeError(
            "the fit failed", next_step="look for extreme values in the table, or start from another file"
        )
    if isinstance(found, LotRefinementAnswer) and found.verdict == "unknown":
        raise NegativeError(
            "a misfit remains that no irregularity of the library explains",
            value=found.verdict,
            allowed="adequate or class",
            next_step="see where it lies with --out FOLDER; write your own irregularity (docs/how-to/add-an-irregularity.md)",
        )


def simulate_lot(out: Path, population: Path | None, irregularities: Sequence[str], seed: int) -> None:
    """See ``gyroscreen simulate --help``, with --lot."""
    from ..lots.simulate import simulate_lot as simulated

    devices, wafers = simulated(out, start_population(population) or load_spec(None), irregularities, seed)
    print(f"{out}: {devices} devices of {wafers} wafers; what was changed is in truth.json")


def demo_lot(out: Path, seed: int | None) -> None:
    """See ``gyroscreen demo --help``, with --lot."""
    from pipeline.learning.lot.table import LotTable

    from ..studies.lots import sized

    start = time.monotonic()
    chosen = int(time.time()) % 100_000 if seed is None else seed
    hidden, _ = sized("one", chosen)
    print(f"a lot with a hidden irregularity was measured (seed {chosen}); searching ...", file=sys.stderr)
    answers = lot_answers(LotTable(hidden.lot, True, "package", {}), hidden.spec)
    with working("demo", quiet=False):
        found = answers.refinement
        truth = ", ".join(hidden.truth)
        path = _written("refine", answers, out, truth=truth)
    print("\n".join(lot_lines(found)))
    print(f"the truth: {truth}")
    print(f"{path}  ({time.monotonic() - start:.0f} s)")


def hidden_irregularities(kind: str, lots: int, seed: int, out: Path, json: bool) -> None:
    """See ``gyroscreen benchmark hidden-irregularities --help``."""
    from ..studies.hidden_lots import KINDS, LotKind
    from ..studies.lot_figures import figures
    from ..studies.lots import study

    if kind != "all" and kind not in KINDS:
        raise UsageError("no such kind", value=kind, allowed=", ".join(("all", *KINDS)), next_step="correct --kind")
    kinds: tuple[LotKind, ...] = tuple(one for one in KINDS if kind in ("all", one))
    rows = []
    for row in study(kinds, lots, out / "rows.jsonl", seed):
        rows.append(row)
        print(f"{row['kind']} {row['seed']}: {row['truth']} -> {row['verdict']} {row['named']}", file=sys.stderr)
    found = figures(rows)
    print(json_.dumps(found) if json else "\n".join(f"{name}: {value}" for name, value in found.items()))
