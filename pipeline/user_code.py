"""Faults of the user's own Python files as typed errors: file, line, the statement, and the reason in one message.

The place is, in this order: that of a syntax error; the first one that a message of numba tells; the last frame of the traceback
that lies in the file; ``error.loc`` of numba; the ``return`` of a function whose result is wrong.
"""

from __future__ import annotations

import ast
import re
import traceback
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from .errors import ConfigError

_NUMBA_PLACE = re.compile(r'File "([^"]+)", line (\d+)')
_ESCAPE = re.compile(r"\x1b\[[0-9;]*m")
#: How the names of modules begin that are loaded from the user's files.
MODULES = ("user_effect_", "user_irregularity_")
#: Statements that numba does not compile and for which it names no line.
_UNCOMPILED = (
    ast.With,
    ast.Try,
    ast.Yield,
    ast.YieldFrom,
    ast.Await,
    ast.ClassDef,
    ast.Import,
    ast.ImportFrom,
    ast.Delete,
)


def content_digest(file: Path) -> str:
    """SHA-256 of the content of a file; "" where it cannot be read, which loading it reports."""
    try:
        return sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


def fault(what: str, error: BaseException, file: str | Path, next_step: str, allowed: str = "") -> ConfigError:
    """The typed error of an exception that a user's file has caused.

    Parameters
    ----------
    what : what failed, one clause: "the force of the effect 'mine' fails".
    error : the exception, with its traceback.
    file : the user's file.
    next_step, allowed : as of every typed error.
    """
    return fault_at(what, reason(error), file, line_of(error, file), next_step, allowed)


def fault_of(error: BaseException) -> ConfigError | None:
    """The typed error of an exception that arose in a user's file, whatever called it; ``None`` for any other."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    for frame in reversed(frames):
        if str(frame.f_globals.get("__name__", "")).startswith(MODULES):
            file = frame.f_code.co_filename
            return fault("your own code fails", error, file, "correct this line, or what it is given")
    return None


def fault_at(what: str, why: str, file: str | Path, line: int | None, next_step: str, allowed: str = "") -> ConfigError:
    """The same for a known place; ``line`` from 1, or ``None``."""
    statement = _statement(file, line)
    place = f"{file}, line {line}" if line else str(file)
    return ConfigError(f"{what}, {place}: {why}", value=statement or None, allowed=allowed, next_step=next_step)


def line_of(error: BaseException, file: str | Path) -> int | None:
    """The line of ``file`` at which ``error`` arose; ``None`` where it is not known."""
    own = Path(file).resolve()
    if isinstance(error, SyntaxError) and error.filename is not None and Path(error.filename).resolve() == own:
        return error.lineno
    if _of_numba(error) and (line := _told_line(error, own)) is not None:
        return line
    frames = [one.lineno for one in traceback.extract_tb(error.__traceback__) if Path(one.filename).resolve() == own]
    if frames:
        return frames[-1]
    location: Any = getattr(error, "loc", None)
    if location is not None and Path(str(location.filename)).name == own.name:
        return int(location.line)
    return None


def _of_numba(error: BaseException) -> bool:
    return type(error).__module__.startswith("numba")


def _told_line(error: BaseException, file: Path) -> int | None:
    """The first line of ``file`` that a message of numba tells: the innermost, of a function that the compiled one calls."""
    for match in _NUMBA_PLACE.finditer(_ESCAPE.sub("", str(error))):
        if Path(match[1]).name == file.name:
            return int(match[2])
    return None


def line_of_compilation(error: BaseException, function: Callable[..., Any], file: str | Path) -> int | None:
    """The line at which numba failed to compile ``function``: as :func:`line_of`, else its first statement that numba never
    compiles, else its first line."""
    first = int(function.__code__.co_firstlineno)
    line = line_of(error, file)
    if line is not None and line != first:
        return line
    body = _function(file, first)
    found = [node.lineno for node in ast.walk(body) if isinstance(node, _UNCOMPILED)] if body else []
    return min(found, default=first)


def line_of_result(function: Callable[..., Any], file: str | Path) -> int:
    """The line of the last ``return`` of a function; of its head where it has none."""
    first = int(function.__code__.co_firstlineno)
    body = _function(file, first)
    returns = [node.lineno for node in ast.walk(body) if isinstance(node, ast.Return)] if body else []
    return max(returns, default=first)


def reason(error: BaseException) -> str:
    """Why, in one line; numba's messages without their frame."""
    text = _ESCAPE.sub("", str(error)).strip()
    if isinstance(error, SyntaxError):
        return f"SyntaxError: {error.msg}"
    if not _of_numba(error):
        first = text.splitlines()[0] if text else ""
        return f"{type(error).__name__}: {first}".removesuffix(": ")
    return _numba_reason([line.strip() for line in text.splitlines() if line.strip()])


def _numba_reason(lines: list[str]) -> str:
    told = [line for line in lines if not line.startswith("Failed in ")] or lines
    first = told[0]
    if found := re.match(r"Untyped global name '(\w+)'", first):
        return (
            f"numba does not know {found[1]!r}: a function that a force calls is compiled, too (@numba.njit above it)"
        )
    if found := re.match(r"Unknown attribute '(\w+)' of type (\w+)(.*)", first):
        module = re.search(r"<module '([\w.]+)'", found[3])
        return f"numba does not know {found[1]!r} of {module[1] if module else found[2]}"
    if "'$" in first and "return_value" in first:
        return "a force adds to out and returns nothing"
    if "No implementation of function" in first:
        call = next((line.removeprefix(">>> ") for line in told if line.startswith(">>> ")), "")
        specific = next((line.partition(": ")[2] for line in told if re.match(r"Numba\w*Error: ", line)), "")
        return f"numba cannot compile {call or first}" + (f": {specific}" if specific else "")
    return f"numba: {first}"


def _statement(file: str | Path, line: int | None) -> str:
    """The text of a line; "" where the file cannot be read."""
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    return lines[line - 1].strip() if line and 0 < line <= len(lines) else ""


def _function(file: str | Path, first: int) -> ast.AST | None:
    """The function of a file whose head, with its decorators, contains the line ``first``."""
    try:
        tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError):
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            heads = [node.lineno, *(decorator.lineno for decorator in node.decorator_list)]
            if min(heads) <= first <= max(heads):
                return node
    return None
