"""Mutated measurements, configurations and TOML shapes through the command line, in one long-lived process.

    python tests/measure/mutations.py files|configs|shapes|files2|init COUNT OUT.jsonl [SEED]

One line per case: number, kind, exit code, processor seconds, growth of the peak memory [MB].  The same command goes on with the
cases that are missing in OUT.jsonl.  A case that ends its process, or takes 120 s, is a line with code null, and is tried again
by the next command.  The summary is printed at the
end; the exit code is 1 where a code is not documented, or a case took more than 10 s or 1000 MB.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import json
import os
import random
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests import mutated
from tests.mutated_more import files2_case, init_case

#: By name; a new study has a new name, so that the numbers of the others keep their meaning.
CASES = {**mutated.CASES, "files2": files2_case, "init": init_case}
DOCUMENTED = {0, 1, 2, 3, 4, 5}
SECONDS, MEGABYTES, PATIENCE_S = 10.0, 1000.0, 120


def peak_mb() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0


def one(kind: str, number: int, seed: int, folder: Path) -> dict[str, object]:
    """A case, by its number alone."""
    from workflows.cli import call

    what, arguments = CASES[kind](random.Random(f"{kind}-{seed}-{number}"), folder)
    Path("/proc/self/clear_refs").write_text("5")
    before, started, said = peak_mb(), time.process_time(), io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        code = call(arguments)
    seconds, grown = time.process_time() - started, peak_mb() - before
    found = {"n": number, "what": what, "code": code, "s": round(seconds, 3), "mb": round(grown, 1)}
    if code not in DOCUMENTED or "Traceback" in said.getvalue():
        found["said"] = said.getvalue()[-400:]
    return found


def work(kind: str, numbers: list[int], seed: int, out: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="gyroscreen-mutations-") as name, out.open("a") as file:
        for number in numbers:
            faulthandler.dump_traceback_later(PATIENCE_S, exit=True)
            print(json.dumps(one(kind, number, seed, Path(name))), file=file, flush=True)
            faulthandler.cancel_dump_traceback_later()


def rows(out: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def main(kind: str, count: int, out: Path, seed: int = 1) -> int:
    if out.exists():
        out.write_text("".join(json.dumps(row) + "\n" for row in rows(out) if row["code"] is not None))
    while left := sorted(set(range(count)) - {int(str(row["n"])) for row in rows(out)}):
        child = os.fork()
        if child == 0:
            work(kind, left, seed, out)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        missing = sorted(set(left) - {int(str(row["n"])) for row in rows(out)})
        if status and missing:
            lost = {
                "n": missing[0],
                "what": "process ended",
                "code": None,
                "s": PATIENCE_S,
                "mb": 0.0,
                "status": status,
            }
            with out.open("a") as file:
                print(json.dumps(lost), file=file)
    found = rows(out)
    codes = {code: sum(row["code"] == code for row in found) for code in sorted({str(row["code"]) for row in found})}
    codes = {str(c): sum(str(row["code"]) == c for row in found) for c in codes}
    seconds, grown = ([float(str(row[key])) for row in found] for key in ("s", "mb"))
    bad = [
        r
        for r in found
        if r["code"] not in DOCUMENTED or float(str(r["s"])) > SECONDS or float(str(r["mb"])) > MEGABYTES
    ]
    print(f"{len(found)} {kind}: codes {codes}, longest {max(seconds):.2f} s, median {np.median(seconds):.3f} s, "
          f"largest growth {max(grown):.0f} MB, {len(bad)} outside the limits")  # fmt: skip
    for row in bad[:20]:
        print(row)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), *map(int, sys.argv[4:5])))
