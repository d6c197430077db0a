"""The user's own effects and irregularities on the workers of a cluster, which do not see the files of the driver."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from distributed import Client, WorkerPlugin

from pipeline.errors import UsageError
from pipeline.store.files import sha256


class ShippedCode(WorkerPlugin):
    """Writes files to a worker before its first task, also to one that joins later.

    They stay in the temporary folder of its machine: other workers there may read them.

    Parameters
    ----------
    texts : path -> content.
    """

    def __init__(self, texts: Mapping[str, str]) -> None:
        self.texts = dict(texts)
        self.name = f"gyroscreen-code-{sha256(repr(sorted(self.texts.items())).encode())[:16]}"

    def setup(self, worker: Any) -> None:
        """Write the files that are not there yet."""
        for path, text in self.texts.items():
            wanted = Path(path)
            if wanted.exists():
                continue
            wanted.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            # Several workers of a machine start at once.
            handle, staged = tempfile.mkstemp(dir=wanted.parent, suffix=".staged")
            with os.fdopen(handle, "wb") as file:
                file.write(text.encode())
            Path(staged).replace(wanted)


@contextmanager
def shipped(client: Client, texts: Mapping[str, str]) -> Iterator[None]:
    """Keep the files ``texts`` (path -> content) on all workers of ``client``.

    Raises
    ------
    UsageError : a worker cannot write them.
    """
    if not texts:
        yield
        return
    plugin = ShippedCode(texts)
    try:
        client.register_plugin(plugin)
    except OSError as error:
        raise UsageError(
            f"a worker cannot store the user's effects and irregularities ({error})",
            value=Path(next(iter(texts))).parent,
            allowed="a temporary folder with free space on every worker",
            next_step="free space there, or leave the worker out",
        ) from None
    try:
        yield
    finally:
        client.unregister_worker_plugin(plugin.name)
