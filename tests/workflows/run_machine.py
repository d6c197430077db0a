"""A night as a state machine: run, kill at any write, resume, change of an input, verify, query, amend, against a dict.

The reference knows each device's theta from its number alone, and what was amended.  The command runs in this process; its
devices are stubs, and the disk may end the process at any operation.
"""

from __future__ import annotations

import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from pipeline.store import checkpoint, journal
from pipeline.store.query import query
from pipeline.store.read import list_runs, read_run
from pipeline.store.run import open_run
from pipeline.store.schema import devices_table
from pipeline.store.verify import verify
from tests.disk import Disk, ProcessEnd, failing
from tests.stub_runs import run_arguments, stub_runs
from workflows.cli import call
from workflows.screening.block import BlockTables, DeviceBlock

DEVICES = 10
MOMENTS = st.integers(1, 130)
#: What the disk does, and the exit codes of a command on it.
FAULTS = {"full": (3,), "EIO": (3,), "kill before": (), "kill after": ()}


def theta(number: int) -> float:
    """Theta of a stub device [deg]."""
    return 0.37 * number


def _block(_: Any, at: DeviceBlock) -> BlockTables:
    numbers = range(at.first, at.first + at.count)
    columns = {"device_id": [f"{n:06d}" for n in numbers], "theta_deg": [theta(n) for n in numbers]}
    done = {"status": ["ok"] * at.count, "verdict": ["pass"] * at.count}
    return BlockTables(at.index, devices_table({**columns, **done}), None, {"ok": at.count})


class Night(RuleBasedStateMachine):
    """See the head of the module."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="gyroscreen-night-"))
        self.patch = pytest.MonkeyPatch()
        stub_runs(self.patch, _block)
        self.patch.setattr(checkpoint, "BLOCKS", 2)
        self.patch.setattr(journal, "_LEAST_LINES", 2)
        self.results = self.folder / "results"
        self.arguments: list[str] = []
        self.changed = self.complete = False
        self.stored: dict[str, float] = {}
        self.amended: dict[str, float] = {}

    def teardown(self) -> None:
        self.patch.undo()
        shutil.rmtree(self.folder)

    @initialize()
    def configuration(self) -> None:
        self.arguments = run_arguments(self.folder, DEVICES)

    def _call(self, arguments: list[str], kind: str = "", moment: int = 0) -> int | None:
        """Exit code; ``None`` if the process ended on the way."""
        code = None
        with failing(Disk(self.results, kind, moment)), suppress(ProcessEnd):
            code = call(arguments)
        return code

    def _resume(self, kind: str = "", moment: int = 0) -> int | None:
        return self._call(["run", "--resume", "latest", "--out", str(self.results)], kind, moment)

    @precondition(lambda self: not self._begun() and not self.changed)
    @rule(kind=st.sampled_from(sorted(FAULTS)), moment=MOMENTS)
    def run_and_fail(self, kind: str, moment: int) -> None:
        """A new night on a disk that fails at the ``moment``-th operation, if it has so many."""
        code = self._call(self.arguments, kind, moment)
        assert code in (None, 0, 2, *FAULTS[kind]), code  # 2: the folder of the run could not be made

    @precondition(lambda self: self._begun())
    @rule(kind=st.sampled_from(sorted(FAULTS)), moment=MOMENTS)
    def resume_and_fail(self, kind: str, moment: int) -> None:
        assert self._resume(kind, moment) in (None, 0, *FAULTS[kind])

    @precondition(lambda self: self._begun())
    @rule()
    def resume(self) -> None:
        assert self._resume() == 0
        self.complete = True

    @precondition(lambda self: self._begun())
    @rule()
    def change_the_configuration(self) -> None:
        """The run keeps its own copy; a resume that asks for the changed file is refused."""
        run_arguments(self.folder, DEVICES, "[limits.split_hz]\nmax = 3.0\n")
        self.changed = True
        asked = ["run", str(self.folder / "fab.toml"), "--resume", "latest", "--out", str(self.results)]
        assert self._call(asked) == 2

    @precondition(lambda self: bool(self.stored))
    @rule(
        number=st.integers(0, DEVICES - 1), value=st.floats(0.0, 1.0), kind=st.sampled_from(["", "EIO", "kill after"])
    )
    def amend(self, number: int, value: float, kind: str) -> None:
        name = f"{number:06d}"
        with failing(Disk(self.results, kind, 3)), suppress(ProcessEnd, Exception):
            open_run(self.results).amend_devices({name: {"p_pass_with_effects": value}})
        now = self._column("p_pass_with_effects")
        if name in self.stored:
            assert now[name] in (value, self.amended.get(name))
            if not kind:
                assert now[name] == value
        if now.get(name) is not None:
            self.amended[name] = now[name]

    @precondition(lambda self: self._begun())
    @rule()
    def ask(self) -> None:
        found = query("SELECT count(*) AS n, sum(theta_deg) AS theta FROM devices", self.results).to_pylist()[0]
        assert found["n"] == len(self.stored)
        assert (found["theta"] or 0.0) == pytest.approx(sum(self.stored.values()))

    @invariant()
    def nothing_is_lost_doubled_or_changed(self) -> None:
        if not self._begun():
            return
        assert verify(self.results).ok
        now = self._column("theta_deg")
        assert self.stored.items() <= now.items()
        assert all(value == theta(int(name)) for name, value in now.items())
        assert {k: v for k, v in self._column("p_pass_with_effects").items() if v is not None} == self.amended
        self.stored = now
        if self.complete:
            assert len(now) == DEVICES
            assert list_runs(self.results)[-1].status == "complete"

    def _begun(self) -> bool:
        return bool(list_runs(self.results))

    def _column(self, name: str) -> dict[str, Any]:
        table = read_run(self.results).devices
        ids = table.column("device_id").to_pylist()
        assert len(set(ids)) == len(ids)
        return dict(zip(ids, table.column(name).to_pylist()))
