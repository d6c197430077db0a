"""Time each part of a device beside its peers, write the table, and report parts that became slower.

    python -m tests.bench                  docs/reference/parts.md anew; exit code 1 if a part became slower than allowed
    python -m tests.bench --accept 3       time the parts 3 times and store their ratios: docs/reference/parts.json and its table
    python -m tests.bench -k arx           some benchmarks only, to the terminal; nothing is written

Needs the extra "bench"; peers that are not installed are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from .guard import FACTOR, Stored, read_stored, slower, spread_table, spreads, write_stored
from .table import Results, results_of, table_of
from .timing import SECONDS

ROOT = Path(__file__).parents[2]
PAGE, RATIOS = ROOT / "docs" / "reference" / "parts.md", ROOT / "docs" / "reference" / "parts.json"


def measured(only: str = "", seconds: float = SECONDS) -> Results:
    """The results of the benchmarks whose names match ``only`` as in ``pytest -k``; the primitives are always measured.

    ``seconds`` is the processor time for each.

    Raises
    ------
    RuntimeError : a benchmark failed.
    """
    with tempfile.TemporaryDirectory(prefix="gyroscreen-bench-") as folder:
        out = Path(folder) / "benchmarks.json"
        command = [sys.executable, "-m", "pytest", "-p", "no:xdist", "-o", "addopts=", "-o", "python_files=bench_*.py"]
        command += ["-q", "--import-mode=importlib", "--benchmark-timer=time.process_time", "--benchmark-disable-gc"]
        command += ["--benchmark-columns=min,median,rounds", f"--benchmark-json={out}", f"--bench-seconds={seconds}"]
        command += [str(ROOT / "tests" / "bench"), *(["-k", f"primitive or {only}"] if only else [])]
        # Called from a test on a worker of pytest-xdist, pytest-benchmark would take this process for a worker and not measure.
        own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_XDIST")}
        done = subprocess.run(command, cwd=ROOT, env=own, stdout=sys.stderr, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"a benchmark failed: pytest ended with exit code {done.returncode}")
        return results_of(json.loads(out.read_text(encoding="utf-8"))["benchmarks"])


def blas_kernel() -> str:
    """The kernel of numpy's BLAS library, such as "Haswell"."""
    np.linalg.qr(np.eye(2))
    return next((str(one["architecture"]) for one in threadpool_info() if one["user_api"] == "blas"), "unknown")


def with_table(page: str, name: str, table: str) -> str:
    """The page with the text between the comments ``name`` and ``end of name`` replaced.

    Raises
    ------
    ValueError : the page has no such comments.
    """
    start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, found, rest = page.partition(start)
    _, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"the page has no lines {start.strip()} and {end}")
    return before + start + table + end + after


def write_table(name: str, table: str) -> None:
    """Replace a table of docs/reference/parts.md."""
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), name, table), encoding="utf-8")


def reported(results: Results, blas: str) -> int:
    """Print the parts that became slower; exit code 1 if there are any."""
    stored = read_stored(RATIOS)
    if stored.blas != blas:
        print(f"ratios were stored with BLAS kernel {stored.blas}, this is {blas}: not compared")
        return 0
    found = slower(results, stored)
    for name, (before, now) in found.items():
        print(f"slower: {name}: {now:.3g} reference loops, stored {before:.3g}, allowed {FACTOR:g} times as many")
    return 1 if found else 0


def main(arguments: list[str]) -> int:
    """Exit code: 1 if a part became slower."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description="Time the parts of a device.")
    group = parser.add_mutually_exclusive_group()
    group.add_argument("-k", default="", dest="only", help="as pytest -k; prints the table and writes nothing")
    group.add_argument("--accept", type=int, default=0, metavar="RUNS", help="store the ratios of so many runs")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="processor time for each benchmark [s]")
    chosen = parser.parse_args(arguments)
    if chosen.accept:
        stored = Stored(blas_kernel(), spreads([measured("part", chosen.seconds) for _ in range(chosen.accept)]))
        write_stored(RATIOS, stored)
        write_table("spreads", spread_table(stored))
        return 0
    results, blas = measured(chosen.only, chosen.seconds), blas_kernel()
    table = f"BLAS kernel {blas}.\n\n{table_of(results)}"
    if chosen.only:
        print(table)
    else:
        write_table("parts", table)
    return reported(results, blas)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
