"""Memory and processor time of a run and its workers: ``gyroscreen run`` with the given arguments, looked at every 20 ms.

usage: python -m tests.measure.worker_memory FOLDER [ARGUMENT..]; FOLDER is for the results.  Prints, for each process, its
greatest memory [MB] while blocks are computed and over all, and its processor time [s]; then the times of the events of the log.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil

_LOOK_S = 0.02


def main() -> None:
    """Run, look and print."""
    folder = Path(sys.argv[1])
    command = [sys.executable, "-m", "workflows.cli", "run", "--out", str(folder), *sys.argv[2:]]
    started = time.monotonic()
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    driver = psutil.Process(run.pid)
    seen: dict[int, psutil.Process] = {run.pid: driver}
    identifying: dict[int, int] = {}
    greatest: dict[int, int] = {}
    seconds: dict[int, float] = {}
    while run.poll() is None:
        with suppress(psutil.Error):
            for child in driver.children():
                seen.setdefault(child.pid, child)
        examined = any('"examine"' in log.read_text() for log in folder.glob("run=*/log.jsonl"))
        for pid, process in seen.items():
            with suppress(psutil.Error):
                size, times = process.memory_info().rss, process.cpu_times()
                greatest[pid] = max(greatest.get(pid, 0), size)
                seconds[pid] = times.user + times.system
                if not examined:
                    identifying[pid] = max(identifying.get(pid, 0), size)
        time.sleep(_LOOK_S)
    print(f"exit code {run.returncode}, {time.monotonic() - started:.1f} s")
    for pid in seen:
        name = "driver" if pid == run.pid else "worker"
        print(
            f"{name} {pid}: {identifying.get(pid, 0) / 1e6:.0f} MB while identifying, {greatest.get(pid, 0) / 1e6:.0f} MB "
            f"at most, {seconds.get(pid, 0.0):.1f} s of processor time"
        )
    for log in folder.glob("run=*/log.jsonl"):
        events = [json.loads(line) for line in log.read_text().splitlines()]
        print("; ".join(f"{event['time'][14:23]} {event['event']}" for event in events))


if __name__ == "__main__":
    main()
