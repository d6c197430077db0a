"""Measure how easy the code is to follow; prints one JSON object.

    python tests/measure/structure.py refine CAMPAIGN     call path from `gyroscreen refine CAMPAIGN --out` to the written page
    python tests/measure/structure.py run                 call path from `gyroscreen run` (2 devices) to the written report
    python tests/measure/structure.py code                lines by package, files longer than 300 lines, repeated class names

A call path is traced while the command runs.  It covers the code that orchestrates the work: ``workflows``, ``reports``,
``pipeline/learning`` and ``pipeline/criticism``.  The numerical packages below them and class bodies are left out.

    files     distinct files of which a function is called
    returns   distinct calls from one file into another that had been entered before from elsewhere: the number of times a
              reader who follows the path comes back to a file already read
"""

from __future__ import annotations

import ast
import json
import sys
import tempfile
import threading
from collections import Counter
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[2]
PACKAGES = ("pipeline", "populations", "reports", "workflows")
#: Where the loop and the batch are orchestrated.  In older trees the learning code is found in ``workflows``.
TRACED = ("workflows", "reports", "pipeline/learning", "pipeline/criticism")
LONG = 300


def _importing(frame: FrameType) -> bool:
    """Whether the call happens while a module is being imported."""
    back = frame.f_back
    while back is not None:
        if back.f_code.co_filename.startswith("<frozen importlib"):
            return True
        back = back.f_back
    return False


class Trace:
    """Calls between project files, in the order in which they first happen."""

    def __init__(self) -> None:
        self.files: list[str] = []
        self.edges: list[tuple[str, str]] = []
        self._seen: set[tuple[str, str]] = set()
        self._known: dict[str, str] = {}

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        if event != "call" or not frame.f_code.co_flags & CO_OPTIMIZED:
            return
        callee = self._file(frame)
        if not callee:
            return
        back, caller = frame.f_back, ""
        while back is not None and not (caller := self._file(back)):
            back = back.f_back
        if caller == callee or (caller, callee) in self._seen or _importing(frame):
            return
        self._seen.add((caller, callee))
        if callee not in self.files:
            self.files.append(callee)
        if caller:
            self.edges.append((caller, callee))

    def _file(self, frame: FrameType) -> str:
        name = frame.f_code.co_filename
        if name not in self._known:
            path = Path(name)
            inside = path.suffix == ".py" and path.is_relative_to(ROOT)
            inside = inside and path.relative_to(ROOT).as_posix().startswith(TRACED)
            self._known[name] = path.relative_to(ROOT).as_posix() if inside else ""
        return self._known[name]

    def summary(self) -> dict[str, object]:
        """Counts, and the files in order."""
        entered: set[str] = set()
        returns = 0
        for _, callee in self.edges:
            returns += callee in entered
            entered.add(callee)
        return {"files": len(self.files), "returns": returns, "path": self.files}


def traced(arguments: list[str]) -> dict[str, object]:
    """The call path of one command of the command line."""
    sys.path.insert(0, str(ROOT))
    from workflows.cli import main as command

    trace = Trace()
    threading.setprofile(trace)
    sys.setprofile(trace)
    try:
        command(arguments)
    except SystemExit:
        pass
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return trace.summary()


def code() -> dict[str, object]:
    """Lines by package, long files, and class names that are used for more than one thing."""
    lines: Counter[str] = Counter()
    long: dict[str, int] = {}
    classes: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix not in (".py", ".j2", ".css", ".toml") or "__pycache__" in path.parts:
                continue
            text = path.read_text(encoding="utf-8")
            count = len(text.splitlines())
            lines[package] += count
            name = path.relative_to(ROOT).as_posix()
            if path.suffix != ".py":
                continue
            if count > LONG:
                long[name] = count
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.ClassDef):
                    classes.setdefault(node.name.lstrip("_"), []).append(name)
    twice = {name: where for name, where in classes.items() if len(where) > 1}
    return {
        "lines": {**lines, "total": sum(lines.values())},
        "files longer than 300 lines": long,
        "class names with two meanings": twice,
    }


def main() -> int:
    """Parse the command line and print."""
    what, *rest = sys.argv[1:] or ["code"]
    if what == "code":
        found = code()
    else:
        with tempfile.TemporaryDirectory() as folder:
            if what == "refine":
                found = traced(["refine", *rest, "--out", folder, "--json"])
            elif what == "run":
                found = traced(["run", "--devices", "2", "--workers", "1", "--out", folder, "--json"])
            else:
                print(__doc__, file=sys.stderr)
                return 2
    print(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
