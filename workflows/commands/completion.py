"""gyroscreen completion: the script of a shell, which asks this program for what can follow."""

from __future__ import annotations

from pathlib import Path

# typer has these in its public module, but does not mark them as exported.
from typer.completion import get_completion_script  # type: ignore[attr-defined]
from typer.completion import install as install_script  # type: ignore[attr-defined]

from pipeline.errors import UsageError, unwritable
from reports.words.completion import HOW_TO, installed_line

from .groups.complete import SHELLS, VARIABLE

PROGRAM = "gyroscreen"
#: zsh loads the file at the first Tab and runs it in place of the function, which would leave this Tab without an answer.
_ZSH_FIRST_TAB = 'if [[ $zsh_eval_context[-1] == loadautofunc ]]; then\n  _gyroscreen_completion "$@"\nfi\n'


def completion(shell: str | None, install: bool) -> None:
    """See ``gyroscreen completion --help``.

    Raises
    ------
    UsageError : another shell, --install without one, or the home folder cannot be written.
    """
    if shell is None:
        if install:
            raise UsageError(
                "--install needs the name of the shell",
                allowed=", ".join(SHELLS),
                next_step="gyroscreen completion bash --install",
            )
        print(HOW_TO)
        return
    if shell not in SHELLS:
        raise UsageError(
            "no script for this shell", value=shell, allowed=", ".join(SHELLS), next_step="gyroscreen completion"
        )
    if not install:
        print(script_of(shell))
        return
    try:
        _, path = install_script(shell=shell, prog_name=PROGRAM, complete_var=VARIABLE)
        if shell == "zsh":
            path.write_text(script_of(shell), encoding="utf-8")
    except OSError as error:
        raise unwritable("the script", error.filename, error, f"gyroscreen completion {shell} prints it") from None
    except UnicodeError:
        raise UsageError(
            "the start-up file of the shell is not UTF-8",
            value=str(Path.home()),
            next_step=f"load the output of `gyroscreen completion {shell}` there yourself",
        ) from None
    print(installed_line(path))


def script_of(shell: str) -> str:
    """The completion script of a shell."""
    script: str = get_completion_script(prog_name=PROGRAM, complete_var=VARIABLE, shell=shell)
    return f"{script.rstrip()}\n\n{_ZSH_FIRST_TAB}" if shell == "zsh" else script
