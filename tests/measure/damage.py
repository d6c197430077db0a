# ruff: noqa: E402 - packages beside this file
"""Byte flips and truncations in every file of a finished and of an interrupted run, over every command that reads it.

    python tests/measure/damage.py OUT.jsonl [FLIPS] [TRUNCATIONS] [EVERY]

After each damage the run is verified, queried and read as the report reads it; after every EVERY-th one the commands `report`
and `run --resume` run, too. A damage counts as detected by a reader if it raises the error of exit code 4 with the name of
the file, as harmless if the answer is that of the sound run, and as wrong otherwise. OUT.jsonl has one line a damage; an
interrupted study continues there.
"""

from __future__ import annotations

import io
import json
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "pipeline" / "store")]

from in_process import InProcess
from store_runs import block_tables
from stub_runs import run_arguments, stub_runs

from pipeline.errors import GyroscreenError, IntegrityError
from pipeline.store import query as queries
from pipeline.store.read import read_run
from pipeline.store.verify import verify
from workflows.cli import call
from workflows.screening.block import BlockTables, DeviceBlock

_QUERIES = (
    "FROM devices ORDER BY device_id",
    "SELECT count(*) AS n, bit_xor(hash(theta_deg)) AS s FROM poster" + "ior",
)
_DEVICES = 6


def _block(_: Any, at: DeviceBlock) -> BlockTables:
    devices, posterior = block_tables(at.index)
    keep = [f"{at.index * 4 + row:06d}" for row in range(2)]
    draws = posterior.filter([name in keep for name in posterior["device_id"].to_pylist()])
    return BlockTables(at.index, devices.slice(0, 2), draws, {"ok": 2})


def _interrupted(source: Any, at: DeviceBlock) -> BlockTables:
    if at.index == 2:
        raise KeyboardInterrupt
    return _block(source, at)


@contextmanager
def runs() -> Iterator[dict[str, Path]]:
    """Results folders with a finished run, and with one whose process was killed; commands run in this process."""
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch, redirect_stderr(io.StringIO()):
        # The report reads all that it needs; only its figures are left out.
        patch.setattr("reports.run.page.render_run_report", lambda *_, **__: "<!doctype html>")
        folders = {}
        for kind, block in (("finished", _block), ("killed", _interrupted)):
            stub_runs(patch, block, page=True)
            (Path(name) / kind).mkdir()
            with pytest.MonkeyPatch.context() as inner:
                if kind == "killed":  # nothing is written after the last commit
                    inner.setattr("pipeline.store.run.RunStore.finish", lambda *_: None)
                with redirect_stdout(io.StringIO()):
                    call(run_arguments(Path(name) / kind, devices=_DEVICES))
            folders[kind] = Path(name) / kind / "results"
        patch.setattr(queries, "QueryProcess", InProcess)
        stub_runs(patch, _block, page=True)
        yield folders


def damages(folder: Path, number: int, flip: bool) -> tuple[str, bytes]:
    """File and damaged content of damage ``number``; the files take turns."""
    files = sorted(path.name for path in folder.iterdir() if path.is_file() and path.name != "writer.lock")
    name, random = files[number % len(files)], np.random.default_rng([number, flip])
    data = bytearray((folder / name).read_bytes())
    if not flip:
        return name, bytes(data[: int(random.integers(len(data)))])
    data[int(random.integers(len(data)))] ^= int(random.integers(1, 256))
    return name, bytes(data)


def readers(results: Path) -> dict[str, Callable[[], Any]]:
    """What is read from a run, by name."""
    return {
        "query devices": lambda: queries.query(_QUERIES[0], results).to_pylist(),
        "query posterior": lambda: queries.query(_QUERIES[1], results).to_pylist(),
        "report": lambda: read_run(results).devices.to_pylist(),
    }


def judged(read: Callable[[], Any], sound: Any, name: str) -> str:
    """Detected, harmless or wrong."""
    try:
        found = read()
    except IntegrityError as error:
        return "detected" if name in str(error) else f"detected, file not named: {error}"
    except GyroscreenError as error:
        return f"wrong: {type(error).__name__}: {error}"
    except Exception as error:
        return f"wrong: untyped {type(error).__name__}: {error}"
    return "harmless" if found == sound else "wrong: another answer"


def commanded(arguments: list[str], results: Path, name: str, sound: Any) -> str:
    """The same for a command on a copy of the results."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "results"
        shutil.copytree(results, copy)
        out, err = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            code = call([*arguments, str(copy)])
        if "Traceback" in err.getvalue() or code not in (0, 4):
            return f"wrong: exit code {code}: {err.getvalue()[-300:]}"
        if code == 4:
            return "detected" if name in err.getvalue() else f"detected, file not named: {err.getvalue()[-300:]}"
        return "harmless" if read_run(copy).devices.to_pylist() == sound else "wrong: another answer"


def study(out: Path, flips: int, truncations: int, every: int) -> None:
    """Make the damages that ``out`` does not have yet, and print the figures."""
    done = {tuple(json.loads(line)["key"]) for line in out.read_text().splitlines()} if out.exists() else set()
    with runs() as folders:
        whole = None
        for kind, results in folders.items():
            folder = next(results.glob("run=*"))
            sound = {name: read() for name, read in readers(results).items()}
            whole = whole or sound["report"]  # a resumed run has the table of the finished one
            for how, count in (("flip", flips // 2), ("truncation", truncations // 2)):
                for number in range(count):
                    if (kind, how, number) in done:
                        continue
                    name, data = damages(folder, number, how == "flip")
                    path = folder / name
                    kept = path.read_bytes()
                    path.write_bytes(data)
                    found = {reader: judged(read, sound[reader], name) for reader, read in readers(results).items()}
                    named = [one for one in verify(results).errors if one.file == str(path)]
                    found["verify"] = "detected" if named else "harmless"
                    if every and number % every == 0:
                        found["report command"] = commanded(["report", "--results"], results, name, sound["report"])
                        found["resume command"] = commanded(
                            ["run", "--resume", "latest", "--out"], results, name, whole
                        )
                    path.write_bytes(kept)
                    with out.open("a") as file:
                        file.write(json.dumps({"key": [kind, how, number], "file": name, "found": found}) + "\n")
    show([json.loads(line) for line in out.read_text().splitlines()])


def show(rows: list[dict[str, Any]]) -> None:
    """Print the figures."""
    for how in ("flip", "truncation"):
        own = [row for row in rows if row["key"][1] == how]
        print(f"{len(own)} {how}s")
        for reader in sorted({reader for row in own for reader in row["found"]}):
            counts = Counter(row["found"][reader].split(":")[0] for row in own if reader in row["found"])
            print(f"  {reader:16s} {', '.join(f'{name} {count}' for name, count in sorted(counts.items()))}")
        silent = Counter(row["file"] for row in own if row["found"]["verify"] == "harmless")
        print(f"  not found by verify, all readers equal: {dict(silent)}")
    for row in rows:
        for reader, found in row["found"].items():
            if not found.startswith(("detected", "harmless")) or "not named" in found:
                print(row["key"], row["file"], reader, found)


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[2:]]
    study(Path(sys.argv[1]), *(*numbers, *(2000, 500, 20)[len(numbers) :]))
