"""Progress of the loop: what is done is shown on stderr, on a terminal at once, elsewhere every 10 s, never with --json."""

import contextlib
import os
import pty
import sys

from pipeline.criticism.announce import announce, announce_fit
from workflows.learning import progress


def test_elsewhere_a_line_is_printed_every_ten_seconds(capfd, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.working("refine", quiet=False):
        for seconds, terms in ((0.0, ()), (4.0, ("a",)), (7.0, ("a", "b")), (1.0, ("c",)), (12.0, ("d",))):
            now[0] += seconds
            announce_fit(terms)
    announce("nobody listens any more")
    shown = capfd.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [
        "refine: 11 s, fitting the given model + a + b",
        "refine: 24 s, fitting the given model + d",
    ]


def test_quiet_shows_nothing_and_a_terminal_a_live_line(capfd, monkeypatch):
    with progress.working("refine", quiet=True):
        announce_fit(("a",))
    assert capfd.readouterr().err == ""
    master, slave = pty.openpty()
    with os.fdopen(slave, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with progress.working("compare", quiet=False):
            announce("testing the absent effects")
    shown = b""
    # One read gives what has arrived so far; the last one fails, because the terminal is closed.
    with contextlib.suppress(OSError):
        while part := os.read(master, 100_000):
            shown += part
    os.close(master)
    assert b"compare" in shown
    assert b"testing the absent effects" in shown
