"""Commit blocks in child processes that are killed with SIGKILL at random moments.

usage: kill_writers.py RESULTS RUN_ID BLOCKS KILLS SEED; prints how many children died by the signal.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from store_runs import block_tables

from pipeline.store.run import open_run


def write_blocks(results: Path, run_id: str, blocks: int) -> None:
    """What a resumed batch does: commit what is missing, write the page again and again."""
    store = open_run(results, run_id)
    for block in range(blocks):
        if block not in store.committed_blocks():
            store.commit_block(block, *block_tables(block))
        store.write_file("report.html", f"<p>{block}</p>".encode() * 1000)
        store.log({"block": block})


def main() -> None:
    """Fork, wait a moment, kill; as often as asked."""
    results, run_id = Path(sys.argv[1]), sys.argv[2]
    blocks, kills, seed = (int(word) for word in sys.argv[3:6])
    moments = random.Random(seed)
    killed = 0
    for _ in range(kills):
        child = os.fork()
        if child == 0:
            write_blocks(results, run_id, blocks)
            os._exit(0)
        # All blocks take less than 0.1 s: what is later finds a writer that has ended.
        time.sleep(moments.uniform(0.002, 0.05))
        os.kill(child, signal.SIGKILL)
        killed += os.WIFSIGNALED(os.waitpid(child, 0)[1])
    print(killed)


if __name__ == "__main__":
    main()
