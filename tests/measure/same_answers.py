"""Record the answers of fixed inputs, and compare two recordings.

    python tests/measure/same_answers.py record DIR            answers of this working tree
    python tests/measure/same_answers.py compare DIR OTHER     exit 1 where they differ

Recorded are the devices table of a fixed run, and the ``--json`` output of compare, diagnose, refine and identify on fixed
campaigns (simulated from fixed seeds) and on a modal record.  ``compare`` asks for identical bytes; with ``--numbers`` it
asks for identical structure, numbers and verdicts, and lists sentences that differ without counting them as a difference.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq

ROOT = Path(__file__).parents[2]
#: Arguments of ``gyroscreen simulate`` by campaign.
CAMPAIGNS = {
    "none": ["--seed", "11"],
    "cubic": ["--seed", "12", "--effect", "cubic_stiffness"],
    "crosstalk": ["--seed", "13", "--effect", "pickoff_crosstalk"],
    "mode": ["--seed", "14", "--effect", "parasitic_mode"],
    "delay": ["--seed", "15", "--effect", "loop_delay"],
    "hum": ["--seed", "16", "--effect", "mains_hum"],
    "clip": ["--seed", "17", "--effect", "adc_saturation"],
    "two": ["--seed", "18", "--effect", "nonlinear_damping", "--effect", "capacitive_feedthrough"],
}
COMMANDS = ("compare", "diagnose", "refine", "identify")
RUN = ["run", "--devices", "24", "--seed", "7", "--json"]
EIGHT_LINES = 8


def gyroscreen(*arguments: str) -> str:
    """Standard output of one command of this working tree."""
    call = [sys.executable, "-c", "import sys; from workflows.cli import main; sys.exit(main())", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(call, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"gyroscreen {' '.join(arguments)} failed:\n{done.stderr}")
    return done.stdout


def record(folder: Path, modal: Path | None) -> None:
    """Write one JSON file per command and campaign, and the devices table of the run as JSON lines."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, arguments in CAMPAIGNS.items():
        gyroscreen("simulate", str(folder / "campaigns" / name), *arguments)
        for command in COMMANDS:
            answer = gyroscreen(command, str(folder / "campaigns" / name), "--json")
            (folder / f"{name}.{command}.json").write_text(answer.replace(str(folder), ""), encoding="utf-8")
    if modal is not None:
        for command in COMMANDS:
            (folder / f"modal.{command}.json").write_text(gyroscreen(command, str(modal), "--json"), encoding="utf-8")
    result = json.loads(gyroscreen(*RUN, "--out", str(folder / "run")))
    for kind in ("devices", "posterior"):
        files = sorted(Path(result["folder"]).glob(f"{kind}-*.parquet"))
        lines = [json.dumps(row, default=str) for file in files for row in pq.read_table(file).to_pylist()]
        (folder / f"run.{kind}.jsonl").write_text("\n".join(lines), encoding="utf-8")


def differences(one: object, other: object, at: str = "") -> Iterator[tuple[str, object, object]]:
    """(place, one, other) of every leaf that differs between two parsed answers."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted({*one, *other}):
            yield from differences(one.get(key, "absent"), other.get(key, "absent"), f"{at}.{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(a, b, f"{at}[{i}]")
    elif one != other and not (one != one and other != other):
        yield at, one, other


def is_sentence(value: object) -> bool:
    """A string that a person reads: names, verdicts and statuses hold no space."""
    return isinstance(value, str) and " " in value


def compare(one: Path, other: Path, numbers_only: bool) -> int:
    """Number of files that differ."""
    names = sorted(p.name for p in one.iterdir() if p.suffix in (".json", ".jsonl"))
    count = 0
    for name in names:
        a, b = ((folder / name).read_text(encoding="utf-8") for folder in (one, other))
        if a == b:
            continue
        parsed = [[json.loads(line) for line in text.splitlines()] for text in (a, b)]
        found = list(differences(*parsed))
        hard = [d for d in found if not (numbers_only and is_sentence(d[1]) and is_sentence(d[2]))]
        count += bool(hard) or not numbers_only
        print(f"{name}: {len(found)} values differ, {len(found) - len(hard)} of them only in wording")
        for place, x, y in hard[:EIGHT_LINES]:
            print(f"    {place}: {x!r} -> {y!r}")
    print(f"{len(names)} files compared, {count} differ")
    return count


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("other", type=Path, nargs="?")
    parser.add_argument("--modal", type=Path, help="a modal record, such as the paper's eq. 14")
    parser.add_argument("--numbers", action="store_true", help="ignore the wording of sentences")
    given = parser.parse_args()
    if given.what == "record":
        record(given.folder.resolve(), given.modal and given.modal.resolve())
        return 0
    if given.other is None:
        parser.error("compare needs two folders")
    return int(compare(given.folder, given.other, given.numbers) > 0)


if __name__ == "__main__":
    sys.exit(main())
