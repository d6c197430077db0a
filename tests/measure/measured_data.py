"""Takes each measured file from the bare file to its ladder, as a user does, and writes the page of docs about it.

    python tests/measure/measured_data.py DATA OUT [NAME..]      init, check, refine of each file; OUT/NAME.json
    python tests/measure/measured_data.py page OUT PAGE          the page from all OUT/NAME.json

The files are copied into OUT, so that the campaigns on the page read as they do for a user.  Lines of campaign.toml that the
files cannot tell, such as which of several columns is the drive, are changed as ``CASES`` states, and the page shows them.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """Files, what is known about them (with its source), and replacements in the campaign.toml that ``init`` writes."""

    files: tuple[str, ...]
    known: str
    changed: tuple[tuple[str, str], ...] = ()


CASES = {
    "robot-arm": Case(
        ("robot_arm.dat",),
        "Torque and acceleration of a flexible robot arm (DaISy); no sample rate is stated, so 1 sample is taken as 1 s. "
        "Two modes at 0.0582 and 0.1267 cycles per sample, zeta 0.3 and 0.5 %; order 2 leaves 21 %, order 4 leaves 3 to 4 %.",
    ),
    "wire-1": Case(("wire-1.txt",), "A vibrating wire in helium: linear, 3966.7 Hz, width 66.7 Hz."),
    "wire-3": Case(
        ("wire-3.txt",),
        "A vibrating wire at several levels: softens; a linear model leaves 48 %, a cubic term 12 %; not exactly cubic.",
    ),
    "magnet-beam": Case(
        ("magnet-beam.lvm",),
        "A cantilever with magnets, released at about 12 s: 40.15 Hz at 160 microstrain, 37.2 Hz at 53, 36.87 Hz at 5; damping "
        "0.57 falling to 0.22 %; the mean shifts by -7.5 at large amplitude.",
    ),
    "ruler": Case(
        ("ruler-swept-1.txt", "ruler-swept-2.txt"),
        "A flexible ruler on a motor, in counts: the command v saturates at +-200; a mode at 17.15 Hz, zeta 2.5 %.",
        (('{ name = "u", unit = "counts" }', '{ name = "v", unit = "counts" }'),),
    ),
}
_RUNG = ("error_fit", "error_validate", "relative_error", "relative_error_validate")


def _command(folder: Path, *words: str) -> tuple[int, str]:
    """Exit code and output of a command in a folder; its messages go to those of this program."""
    done = subprocess.run(
        [sys.executable, "-m", "workflows.cli", *words], cwd=folder, stdout=subprocess.PIPE, text=True
    )
    return done.returncode, done.stdout


def measure(data: Path, out: Path, name: str) -> None:
    """init, check and refine of one case; the answers go to OUT/NAME.json."""
    case, folder = CASES[name], out / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for file in case.files:
        shutil.copyfile(data / file, folder / file)
    code, text = _command(folder, "init", *case.files, "--out", ".")
    campaign = folder / "campaign.toml"
    if code != 0 or not campaign.is_file():
        raise SystemExit(f"init of {name} ended with {code}:\n{text}")
    toml = campaign.read_text(encoding="utf-8")
    for old, new in case.changed:
        if old not in toml:
            raise SystemExit(f"{name}: the campaign.toml of init has no line {old!r}")
        toml = toml.replace(old, new)
    campaign.write_text(toml, encoding="utf-8")
    model = ("--model", "model.toml") if (folder / "model.toml").is_file() else ()
    _, check = _command(folder, "check", ".")
    began = time.monotonic()
    code, answer = _command(folder, "refine", ".", *model, "--json")
    row = {
        "name": name,
        "campaign": toml,
        "model": (folder / "model.toml").read_text(encoding="utf-8") if model else "",
        "check": check,
        "exit": code,
        "seconds": time.monotonic() - began,
        "answer": json.loads(answer),
    }
    (out / f"{name}.json").write_text(json.dumps(row), encoding="utf-8")


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.3g} %"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _section(row: dict) -> str:
    case, answer = CASES[row["name"]], row["answer"]
    lines = [f"## {', '.join(case.files)}", "", f"Known: {case.known}", ""]
    lines += [f"`gyroscreen init {' '.join(case.files)} --out .` writes this campaign.toml"]
    lines[-1] += "; changed by hand: " + "; ".join(f"`{new}`" for _, new in case.changed) if case.changed else ""
    kept = [line for line in row["campaign"].splitlines() if line.strip() and not line.lstrip().startswith("#")]
    lines += ["", "```toml", *kept, "```", ""]
    plant = [line for line in row["model"].splitlines() if line.startswith("plant")]
    lines += [f"and the model `{plant[0]}`.", ""] if plant else []
    wrong = list(answer.get("wrong_form") or ())
    effects = ", ".join(answer["effects"]) or "none"
    lines += [f"`gyroscreen refine .` ends with {row['exit']}: **{answer['verdict']}**, effects: {effects}."]
    if wrong:
        lines += ["", "May have the wrong form: " + ", ".join(wrong) + "."]
    if answer.get("why"):
        lines += ["", f"Reason: {answer['why']}"]
    lines += ["", "| rung | status | error, fitted | held out | left, fitted | held out |", "|---|---|---|---|---|---|"]
    for rung in answer["ladder"]:
        error, held, left, held_left = (rung.get(key) for key in _RUNG)
        cells = [rung["effect"] or "first model", rung["status"] or "", _number(error), _number(held)]
        lines.append("| " + " | ".join([*cells, _percent(left), _percent(held_left)]) + " |")
    modes = {k: v for k, v in answer["parameters"].items() if k.split(".")[-1].rstrip("_hz123456789") in ("f", "zeta")}
    found = {k: v for k, v in modes.items() if v[1] is not None}
    stated = ", ".join(f"{k} = {v[0]:.6g} +- {v[1]:.2g}" for k, v in found.items())
    lines += ["", f"Parameters of the last rung: {stated}."]
    notes = [line.strip() for line in row["check"].splitlines() if "clip" in line.lower()]
    if notes:
        lines += ["", "`gyroscreen check .` says:", "", "```text", *notes, "```"]
    return "\n".join(lines)


def page(out: Path, target: Path) -> None:
    """Writes the page from the measured cases, in the order of ``CASES``."""
    head = """# Measured data from elsewhere

What `init` and `refine` make of files that nobody in this project recorded, beside what is known about them. The files are in
../shared/data/measured. Everything below is written by

    python tests/measure/measured_data.py ../shared/data/measured OUT
    python tests/measure/measured_data.py page OUT docs/reference/measured.md

`error` is the rms of the residual in units of the noise where silence or repeats measure it; `left` is the rms of the residual in
parts of the rms of the record."""
    rows = [json.loads((out / f"{name}.json").read_text()) for name in CASES if (out / f"{name}.json").is_file()]
    target.write_text("\n\n".join([head, *(_section(row) for row in rows)]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1] == "page":
        page(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        for case_name in sys.argv[3:] or CASES:
            measure(Path(sys.argv[1]), Path(sys.argv[2]).resolve(), case_name)
