"""gyroscreen run."""

from __future__ import annotations

import json as json_
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from pipeline.errors import IncompleteError, InterruptedRunError, UsageError, printable_lines
from pipeline.plain import plain
from pipeline.store.run import RunStore, discard_run
from reports.limits_origin import LimitsOrigin, origin_of_file, shipped_origin
from reports.words.lot_origin import origin_lines
from reports.words.preview import NOT_SAMPLED, preview_lines

from ..config import RunConfig, changed_config, load_config, to_toml_table
from ..screening.plan import RunPlan, config_of, plan, resume, start, without_none
from ..screening.preview import preview
from ..screening.settings import population
from .groups.options import DEFAULT_RESULTS

if TYPE_CHECKING:
    from ..screening.outcome import RunResult
    from ..screening.scheduler import Scheduler


def run(
    config: Path | None,
    devices: int | None,
    seed: int | None,
    out: Path,
    workers: int,
    scheduler: Scheduler | None,
    resume_run: str | None,
    dry_run: bool,
    json: bool,
) -> None:
    """See ``gyroscreen run --help``."""
    if workers < 0:
        raise UsageError(
            "--workers is negative", value=workers, allowed="0 (one per core) or more", next_step="correct --workers"
        )
    overrides: dict[str, Any] = {k: v for k, v in (("devices", devices), ("seed", seed)) if v is not None}
    if resume_run is not None:
        planned, store = resume(out, resume_run, _wanted(config, overrides, out, resume_run))
    else:
        wanted = load_config(config, overrides)
        planned, limits = plan(wanted), _limits_of(wanted, config)
        if wanted.sampling is not None:
            print(NOT_SAMPLED, file=sys.stderr)
        if dry_run:
            _show_plan(planned, limits, json)
            return
        planned, store = start(planned, out, limits)
    # A dry run does without the cluster and the report.
    from ..screening.batch import run_batch
    from ..screening.outcome import check_identified, check_targets
    from ..screening.scheduler import UnreachableError

    try:
        result = run_batch(planned, store, out, workers, scheduler, quiet=json)
    except KeyboardInterrupt:
        raise _interrupted(planned, store, out) from None
    except UsageError as error:
        if resume_run is None:
            # The scheduler did not answer, or its workers have another version: an empty run would be the latest one.
            discard_run(store)
        elif isinstance(error, UnreachableError):
            raise IncompleteError(
                error.what, value=error.value, allowed=error.allowed, next_step="start it, and resume the run again"
            ) from None
        raise
    print(json_.dumps(result.to_dict()) if json else printable_lines(_summary(result, out)))
    check_identified(result)
    check_targets(planned.config.targets, result)


def _limits_of(config: RunConfig, path: Path | None) -> LimitsOrigin:
    """Where the limits of a run come from: [limits] of its file, or the shipped default."""
    return origin_of_file(path) if path is not None and config.limits else shipped_origin()


def _wanted(config: Path | None, overrides: dict[str, Any], out: Path, run_id: str) -> RunConfig | None:
    """What the user asks --resume for: CONFIG, or the run's own configuration with --devices and --seed."""
    if config is not None:
        return load_config(config, overrides)
    return changed_config(config_of(out, run_id), overrides) if overrides else None


def _interrupted(planned: RunPlan, store: RunStore, out: Path) -> InterruptedRunError:
    stored = store.manifest.rows("devices")
    return InterruptedRunError(
        f"interrupted; {stored} of {planned.devices} devices are stored",
        next_step=f"gyroscreen run --resume {store.run_id}{_option(out, '--out')}",
    )


def _option(results: Path, name: str) -> str:
    return "" if results == DEFAULT_RESULTS else f" {name} {shlex.quote(str(results))}"


def _show_plan(planned: RunPlan, limits: LimitsOrigin, json: bool) -> None:
    config = planned.config
    table = without_none(to_toml_table(config))
    table["source"].pop("spec_toml", None)
    table["lot_origin"].pop("population_toml", None)
    implied = preview(config)
    spec = population(config).name if config.source.kind == "population" else None
    if json:
        known = {
            "devices": planned.devices,
            "blocks": len(planned.blocks),
            "config": table,
            "population": spec,
            "limits": limits.to_dict(),
            "implied": None if implied is None else implied.to_dict(),
        }
        print(json_.dumps(plain(known)))
        return
    print(tomli_w.dumps(table).rstrip())
    lines = [] if spec is None else [f"population: {spec}, {', '.join(_population_files(planned))}"]
    lines += preview_lines(implied, config.judged_by(), limits)
    print("\n" + printable_lines("\n".join(f"# {line}" for line in lines)))
    print(f"\n{planned.devices} devices in {len(planned.blocks)} blocks; dry run: nothing was run", file=sys.stderr)


def _population_files(planned: RunPlan) -> list[str]:
    """The file of the population, and those that it extends."""
    return [Path(file.path).name for file in planned.inputs.of("population")]


def _summary(result: RunResult, out: Path) -> str:
    verdicts = ", ".join(f"{count} {name}" for name, count in result.verdicts.items())
    statuses = ", ".join(f"{count} {name}" for name, count in result.statuses.items() if count)
    if result.yield_share is None or result.yield_interval is None:
        shown = f"no yield: no device could be identified ({verdicts})"
    else:
        low, high = result.yield_interval
        share = f"yield {100 * result.yield_share:.1f} %"
        shown = f"{share} (95 % interval {100 * low:.1f} to {100 * high:.1f} %): {verdicts}"
    lines = [
        shown,
        f"main cause of loss: {result.main_cause or 'none'}",
        f"status: {statuses}; {result.devices} devices in {result.seconds:.1f} s",
        *([f"effects missing in the model: {', '.join(result.lot_effects)}"] if result.lot_effects else []),
        *([] if result.lot_origin is None else origin_lines(result.lot_origin)),
        f"results: {result.folder}",
        f"report:  {result.report}",
        f'query:   gyroscreen query "SELECT verdict, count(*) AS n FROM devices GROUP BY verdict"{_option(out, "--results")}',
    ]
    return "\n".join(lines)
