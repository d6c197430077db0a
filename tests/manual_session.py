"""Runs the blocks of one page of the manual, in their order, in one folder."""

from __future__ import annotations

import io
import os
import runpy
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from manual_pages import EXAMPLES, SHELL, Block
from manual_readers import READERS

from workflows.cli import call

#: A line with one of these is for a shell.
_SHELL_SIGNS = ("|", ">", "<", "&&", ";", "$", "`", "*")

#: A shell command of the suite that takes longer waits for something.
SHELL_S = 60.0

Runner = Callable[[str, Path], tuple[int, str]]


def commands(text: str) -> list[str]:
    """Commands of a block: continued lines joined, comments and prompts taken away."""
    joined = text.replace("\\\n", " ")
    lines = [line.strip().removeprefix("$ ") for line in joined.splitlines()]
    return [line for line in lines if line and not line.startswith("#")]


def run_in_process(command: str, folder: Path) -> tuple[int, str]:
    """A command of gyroscreen by a call of its function, a script in this process, others by a shell; code and output."""
    try:
        words = shlex.split(command, comments=True)
    except ValueError:
        words = []
    script = len(words) == 2 and words[0] == "python" and words[1].endswith(".py")
    plain = not any(sign in word for word in _unquoted(command) for sign in _SHELL_SIGNS)
    if not (script or words[:1] == ["gyroscreen"]) or not plain:
        return run_by_shell(command, folder, SHELL_S)
    out, err = _stream(), _stream()
    with redirect_stdout(out), redirect_stderr(err):
        if script:
            runpy.run_path(words[1], run_name="__main__")
        code = 0 if script else call(words[1:])
    return code, _text(out) + (_text(err) if code else "")


def run_by_shell(command: str, folder: Path, longest_s: float = 900.0) -> tuple[int, str]:
    """Any command, with the programs of this Python first; exit code and what it printed."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = os.environ | {"PATH": path, "COLUMNS": "120"}
    done = subprocess.run(
        ["sh", "-c", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=longest_s,
        check=False,
    )
    return done.returncode, done.stdout + (done.stderr if done.returncode else "")


def _stream() -> io.TextIOWrapper:
    """A stream like that of a terminal: some commands write bytes to it."""
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)


def _text(stream: io.TextIOWrapper) -> str:
    stream.seek(0)
    return stream.read()


def _unquoted(command: str) -> list[str]:
    """Words of a command that no quotes protect."""
    words = shlex.shlex(command, posix=False, punctuation_chars=False)
    words.whitespace_split, words.commenters = True, "#"
    return [word for word in words if not word.startswith(("'", '"'))]


@dataclass
class Session:
    """The state of a page: its folder, the names that its Python has defined, what its last block printed."""

    folder: Path
    run: Runner
    short: bool
    names: dict[str, Any] = field(default_factory=dict)
    printed: str = ""

    def do(self, block: Block) -> None:
        """Run or read one block.

        Raises
        ------
        AssertionError : the block does not do what the page says; the message names page, line, command and output.
        """
        if block.language not in EXAMPLES or block.mark("not run") is not None:
            return
        shorter = block.mark("run as") if self.short else None
        text = block.text if shorter is None else shorter
        if (name := block.mark("file")) is not None:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_text(text, encoding="utf-8")
        if block.language in SHELL:
            self._shell(commands(text), int(block.mark("exit") or 0), block.where)
        elif block.language == "toml":
            self._toml(text, name, block)
        elif block.language == "python" and name is None:
            self._python(text, block)
        elif block.language == "sql":
            self._shell([f"gyroscreen query {shlex.quote(text)}"], 0, block.where)

    def prepare(self, lines: Iterable[str], where: str) -> None:
        """Commands that the page takes as done."""
        self._shell(lines, 0, where)

    def _shell(self, lines: Iterable[str], last: int, where: str) -> None:
        given, printed = list(lines), []
        for k, command in enumerate(given):
            code, text = self.run(command, self.folder)
            expected = last if k == len(given) - 1 else 0
            assert code == expected, f"{where}: `{command}` ended with {code}, not {expected}:\n{text[-2000:]}"
            printed.append(text)
        self.printed = "".join(printed)

    def _toml(self, text: str, name: str | None, block: Block) -> None:
        reader = block.mark("read as")
        assert reader in READERS, f"{block.where}: `<!-- read as: {'|'.join(READERS)} -->` is missing above this block"
        path = self.folder / (name or f"block-{block.line}.toml")
        path.write_text(text, encoding="utf-8")
        try:
            READERS[reader](path)
        except Exception as error:
            raise AssertionError(f"{block.where}: {error}") from error

    def _python(self, text: str, block: Block) -> None:
        out = io.StringIO()
        # Names of the lines that a traceback shows are those of the page.
        code = compile("\n" * block.line + text, block.page, "exec")
        self.names.setdefault("__name__", "manual")
        with redirect_stdout(out):
            exec(code, self.names)
        self.printed = out.getvalue()
