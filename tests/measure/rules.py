"""Measure what a rule or a threshold of the learning code does, on 100 fixed campaigns with hidden effects.

    python tests/measure/rules.py count                     named numeric constants, by file
    python tests/measure/rules.py record DIR [--set MODULE:NAME=VALUE ...] [--part 1/2] [--kind KIND ...] [--draws FOLDER]
                                                            answers of this working tree, or with other values
    python tests/measure/rules.py lines [--set ..]          the same in a minute: answers to 120 problems without a gyro
    python tests/measure/rules.py compare DIR OTHER         campaigns that differ, McNemar's exact test, ratio of the times

``record`` continues where it was interrupted.  ``NAME`` may be the field of a dataclass: ``Rules.alpha``.  ``compare`` pairs
the campaigns, so a difference is an effect of the rule and not of the draw.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import pickle
import signal
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from scipy.stats import binomtest  # noqa: E402
from threadpoolctl import threadpool_limits  # noqa: E402

from pipeline.criticism.ladder import diagnose  # noqa: E402
from tests.straight_lines import Toy  # noqa: E402
from workflows.studies.hidden.confusion import answer  # noqa: E402
from workflows.studies.hidden.draw import Hidden, hide  # noqa: E402
from workflows.studies.hidden.study import examine  # noqa: E402

#: Where rules decide what an answer says.
COUNTED = ("pipeline/criticism", "pipeline/learning", "pipeline/inference/general")
SEED = 7001
#: Number of campaigns of each kind: 100 in all, about half of them with one hidden effect.
CAMPAIGNS = {
    "none": 8,
    "one": 24,
    "weak": 12,
    "two": 8,
    "outside": 5,
    "left-out": 5,
    "coloured": 2,
    "louder": 2,
    "heavy-tailed": 2,
    "bench-none": 4,
    "bench-one": 8,
    "bench-foreign": 5,
    "lone-none": 3,
    "lone-one": 8,
    "lone-foreign": 4,
}
#: Processor time [s] after which a campaign is given up; it is then left out of every comparison.
LIMIT_S = 90.0
GIVEN_UP = "given up"
TERMS = ("square", "cube", "kink", "bump", "line")


def is_number(node: ast.expr) -> bool:
    """Whether an expression is chosen and not derived: it consists of numbers only."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.Tuple(elts=elements) | ast.List(elts=elements):
            return bool(elements) and all(is_number(element) for element in elements)
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) and is_number(right)
    return False


def constants(path: Path) -> list[tuple[str, str]]:
    """Named numeric constants of a file, and defaults other than 0 and 1 of dataclass fields: (name, value)."""
    found = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts) if several else [(target, node.value)]
            found += [
                (name.id, ast.unparse(value))
                for name, value in pairs
                if isinstance(name, ast.Name) and name.id == name.id.upper() and is_number(value)
            ]
        elif isinstance(node, ast.ClassDef):
            found += [
                (f"{node.name}.{line.target.id}", ast.unparse(line.value))
                for line in node.body
                if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
                if line.value is not None and is_number(line.value) and ast.literal_eval(line.value) not in (0, 1)
            ]
    return found


def count() -> None:
    """Print every constant and their number by folder."""
    total = 0
    for folder in COUNTED:
        found = [(path, *one) for path in sorted((ROOT / folder).rglob("*.py")) for one in constants(path)]
        for path, name, value in found:
            print(f"{path.relative_to(ROOT)}  {name} = {value}")
        print(f"{folder}: {len(found)}")
        total += len(found)
    print(f"all: {total}")


def set_value(setting: str) -> None:
    """Give a constant another value: MODULE:NAME=VALUE."""
    target, value = setting.split("=", 1)
    module_name, name = target.split(":")
    module, number = importlib.import_module(module_name), ast.literal_eval(value)
    if "." not in name:
        assert hasattr(module, name), f"no constant {name} in {module_name}"
        setattr(module, name, number)
        return
    owner, field = name.split(".")
    cls = getattr(module, owner)
    defaulted = [f.name for f in fields(cls) if f.init][-len(cls.__init__.__defaults__) :]
    values = dict(zip(defaulted, cls.__init__.__defaults__))
    assert field in values, f"no field {field} with a default in {owner}"
    cls.__init__.__defaults__ = tuple((values | {field: number}).values())
    setattr(cls, field, number)


def given_up(*_: object) -> None:
    """Handler of the timer."""
    raise TimeoutError


def drawn(kind: str, number: int, draws: Path | None) -> Hidden:
    """A campaign, kept in the folder ``draws``: to draw one takes a third of the time."""
    path = None if draws is None else draws / f"{kind}-{number}-{SEED}.pickle"
    if path is not None and path.exists():
        return cast(Hidden, pickle.loads(path.read_bytes()))
    hidden = hide(kind, number, SEED)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(hidden))
    return hidden


def record(folder: Path, part: str, kinds: Sequence[str], draws: Path | None) -> None:
    """Run the campaigns that ``folder`` lacks and append their rows; all kinds in turn, so that any beginning is a sample."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen = {kind: numbers for kind, numbers in CAMPAIGNS.items() if not kinds or kind in kinds}
    wanted = [(number / numbers, kind, number) for kind, numbers in chosen.items() for number in range(numbers)]
    first, parts = (int(one) for one in part.split("/"))
    done = rows(folder)
    signal.signal(signal.SIGPROF, given_up)
    with (folder / f"part{first}.jsonl").open("a", encoding="utf-8") as file, threadpool_limits(1):
        for _, kind, number in sorted(wanted)[first - 1 :: parts]:
            if (kind, number) in done:
                continue
            row: dict[str, Any] = {"kind": kind, "number": number}
            hidden = drawn(kind, number, draws)
            start = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
            try:
                row = examine(hidden)
            except TimeoutError:
                row |= {"hidden": list(hidden.effects), "diagnose": None, "failed": GIVEN_UP}
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
            row["cpu_seconds"] = time.process_time() - start
            file.write(json.dumps(row, default=float) + "\n")
            file.flush()
            print(kind, number, row["hidden"], answer_of(row), f"{row['cpu_seconds']:.1f} s", flush=True)


def lines() -> None:
    """Print the answers to straight lines with one hidden curve (``tests/straight_lines.py``), by group."""
    groups: dict[str, list[tuple[dict[str, float], tuple[str, ...]]]] = {
        "none": [({}, TERMS)] * 30,
        "SNR 6": [({term: 6.0}, TERMS) for term in TERMS] * 6,
        "SNR 60": [({term: 60.0}, TERMS) for term in TERMS] * 6,
        "two": [({"cube": 60.0, "line": 40.0}, TERMS), ({"bump": 60.0, "square": 30.0}, TERMS)] * 5,
        "outside": [({"outside": 25.0}, TERMS)] * 10,
        "imitated by two": [({"sum": 60.0}, ("square", "left", "right"))] * 5,
        "look-alikes": [({"cube": 30.0}, ("square", "cube", "cube_like", "kink", "line"))] * 5,
    }
    start = time.process_time()
    for group, problems in groups.items():
        found: Counter[str] = Counter()
        for seed, (hidden, library) in enumerate(problems):
            diagnosis = diagnose(Toy().problem(seed, hidden, library=library))
            wrong = [one for one in diagnosis.classes if not set(one.members) & set(hidden)]
            found["wrong" if wrong else diagnosis.verdict] += 1
        print(f"{group}: {dict(sorted(found.items()))}")
    print(f"{time.process_time() - start:.1f} s")


def rows(folder: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """The rows of a folder by kind and number."""
    lines = [line for path in sorted(folder.glob("*.jsonl")) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(row["kind"], row["number"]): row for row in map(json.loads, lines)}


def answer_of(row: dict[str, Any]) -> str:
    """The assessment of a diagnosis, or that it failed."""
    return "failed" if row["failed"] else answer(row, "diagnose")


def is_right(row: dict[str, Any]) -> bool:
    """Whether the answer is the wanted one: the effect, or "unknown" for an effect from outside the library."""
    foreign = row["kind"].endswith(("outside", "left-out", "foreign"))
    wanted = "adequate" if not row["hidden"] else "unknown" if foreign else "right"
    return answer_of(row) == wanted


def compare(one: Path, other: Path) -> None:
    """Print what differs between two recordings."""
    before, after = rows(one), rows(other)
    both = sorted(before.keys() & after.keys())
    both = [key for key in both if GIVEN_UP not in (before[key]["failed"], after[key]["failed"])]
    better = worse = 0
    for key in both:
        old, new = before[key], after[key]
        if said(old) != said(new):
            print(*key, old["hidden"], said(old), "->", said(new))
        better += is_right(new) and not is_right(old)
        worse += is_right(old) and not is_right(new)
    right = [sum(is_right(found[key]) for key in both) for found in (before, after)]
    time_ratio = sum(after[key]["cpu_seconds"] for key in both) / sum(before[key]["cpu_seconds"] for key in both)
    p_value = binomtest(worse, better + worse).pvalue if better + worse else 1.0
    print(f"{len(both)} campaigns: right {right[0]} -> {right[1]}; {better} better, {worse} worse, p = {p_value:.3g}")
    print(f"processor time x {time_ratio:.3f}")


def said(row: dict[str, Any]) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
    """What a diagnosis says: assessment, effects, classes."""
    found = row["diagnose"] or {}
    return answer_of(row), found.get("effects", ()), [c for c in found.get("classes", ()) if len(c) > 1]


def main() -> None:
    """Run the command of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("count")
    recording = commands.add_parser("record")
    recording.add_argument("folder", type=Path)
    recording.add_argument("--set", action="append", default=[], dest="settings")
    recording.add_argument("--part", default="1/1")
    recording.add_argument("--kind", action="append", default=[], dest="kinds", choices=CAMPAIGNS)
    recording.add_argument("--draws", type=Path)
    lining = commands.add_parser("lines")
    lining.add_argument("--set", action="append", default=[], dest="settings")
    comparing = commands.add_parser("compare")
    comparing.add_argument("folder", type=Path)
    comparing.add_argument("other", type=Path)
    given = parser.parse_args()
    if given.command == "count":
        count()
    elif given.command == "lines":
        for setting in given.settings:
            set_value(setting)
        lines()
    elif given.command == "record":
        for setting in given.settings:
            set_value(setting)
        record(given.folder, given.part, given.kinds, given.draws)
    else:
        compare(given.folder, given.other)


if __name__ == "__main__":
    main()
