"""The command line.

``commands/groups`` declares the commands; each one imports its implementation when it runs, so that --help responds at once.

Exit codes: 0 done; 1 the answer is negative; 2 usage or configuration; 3 incomplete, can be resumed; 4 integrity;
5 unreadable measurement; 70 an internal error; 130 interrupted.  docs/reference/exit-codes.md lists what leads to each.
"""

from __future__ import annotations

import errno
import gc
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from pipeline.errors import GyroscreenError, printable_lines
from pipeline.user_code import fault_of

from .commands.groups import benchmarks, devices, interactive, manual, models, nights, populations, screening, shells
from .commands.groups.complete import VARIABLE
from .commands.groups.tasks import CommandsByTask, show_tracebacks, with_debug_everywhere
from .process import INTERRUPTED, end_like_ctrl_c, keep_memory, repeat_lost_interrupts, survive_any_encoding

#: What the file system says when it cannot store what is printed.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
#: What it says about a path that it refuses; nothing was written then.
_REFUSED = (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM, errno.EROFS)

app = typer.Typer(
    name="gyroscreen",
    cls=CommandsByTask,
    help="Monte Carlo screening of MEMS gyroscopes, and comparison of device models with measurements.",
    invoke_without_command=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for _command in (*screening.COMMANDS, *devices.COMMANDS, *interactive.COMMANDS, *shells.COMMANDS, *manual.COMMANDS):
    app.command()(_command)
app.add_typer(models.app, name="model")
app.add_typer(populations.app, name="population")
for _benchmark in nights.BENCHMARKS:
    benchmarks.app.command()(_benchmark)
app.add_typer(benchmarks.app, name="benchmark")


@app.callback()
def _options(
    context: typer.Context,
    debug: Annotated[
        bool,
        typer.Option("--debug", help="Show tracebacks.", callback=show_tracebacks, is_eager=True, expose_value=False),
    ] = False,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    if version:
        from importlib import metadata

        print(f"gyroscreen {metadata.version('gyroscreen')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


def command_line() -> Any:
    """All commands as typer makes them, each with --debug."""
    if VARIABLE in os.environ:  # a shell asks what can follow; typer knows the shells only after this call
        from typer.completion import completion_init  # type: ignore[attr-defined]

        # The summaries hold no markup, and what would render it takes a third of the time for which zsh waits.
        sys.modules.setdefault("rich", None)  # type: ignore[arg-type]
        completion_init()
    return with_debug_everywhere(typer.main.get_command(app))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    # Before numpy is loaded: BLAS threads slow down small matrices, and the workers already use all cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # Allocating huge pages takes longer than processing a record.
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
    # Garbage collection of freshly imported modules takes a fifth of the start-up time, and again at exit.
    gc.set_threshold(50_000)
    # Limits how long a thread waits for the interpreter when it returns from a compiled loop.
    sys.setswitchinterval(1e-3)
    keep_memory()
    survive_any_encoding()
    repeat_lost_interrupts()
    end_like_ctrl_c()
    code = call(arguments)
    # Frozen objects are never collected, which DuckDB reports as a leak at exit.
    if "duckdb" not in sys.modules:
        gc.freeze()
    sys.exit(code)


def call(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code.  Errors become one message on stderr."""
    try:
        # typer turns a KeyboardInterrupt into the value 130; commands themselves return nothing.
        if command_line()(args=None if arguments is None else list(arguments), standalone_mode=False) == INTERRUPTED:
            return _failed("interrupted", INTERRUPTED)
        sys.stdout.flush()
    except GyroscreenError as error:
        return _failed(f"{error}" if error.exit_code == INTERRUPTED else f"error: {error}", error.exit_code)
    except typer.Exit as exit_:
        return int(exit_.exit_code)
    except TyperException as error:
        text = error.format_message() if hasattr(error, "format_message") else str(error)
        return _failed(f"error: {text}; next: gyroscreen --help", 2)
    except (KeyboardInterrupt, typer.Abort):
        return _failed("interrupted", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno in _FULL and error.filename is None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            reason = (error.strerror or "").lower()
            return _failed(
                f"error: the output cannot be written: {reason}; next: free space; stored results are kept", 3
            )
        if error.errno not in _REFUSED:
            return _failed(_defect(error), 70)
        shown = str(error.filename)[:200]
        reason = (error.strerror or "").lower()
        return _failed(f"error: a path cannot be used: {reason}: {shown!r}; next: check the path and permissions", 2)
    except Exception as error:
        if (own := fault_of(error)) is not None:
            return _failed(f"error: {own}", own.exit_code)
        # No input should lead here: an error that is not typed is a defect of gyroscreen.
        return _failed(_defect(error), 70)
    return 0


def _defect(error: Exception) -> str:
    return f"internal error: {type(error).__name__}: {error}; next: run again with --debug and report it"


def _failed(message: str, code: int) -> int:
    if os.environ.get("GYROSCREEN_DEBUG"):
        traceback.print_exc()
    print(printable_lines(message), file=sys.stderr)
    return code


if __name__ == "__main__":
    main()
