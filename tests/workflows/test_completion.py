"""What the Tab key offers, asked for as the shells ask; installation in a home folder; wrong input in one line."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.device.effect import find_effects
from populations.extend import shipped
from populations.irregularity import find
from workflows.cli import call
from workflows.commands.completion import script_of
from workflows.commands.groups import complete

ASK = "import sys; sys.argv[0] = 'gyroscreen'; from workflows.cli import main; main()"


def completions(line: str, folder: Path) -> list[str]:
    """What bash is told to offer for the last word of ``line``."""
    words = line.split(" ")
    asked = {"_GYROSCREEN_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    paths = {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", ASK],
        env=os.environ | asked | paths,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("work")
    for name in ("results/run=20260101-a", "results/run=20260102-b", "other/run=20250101-c", "results/none"):
        (path / name).mkdir(parents=True)
    (path / "mine.toml").write_text("")
    return path


def test_a_question_of_zsh_is_answered_without_what_renders_markup(folder):
    code = (
        f"{ASK.removesuffix('main()')}\n"
        "try: main()\n"
        "finally: print([name for name in ('rich.console', 'rich.markdown', 'numpy') if name in sys.modules])"
    )
    asked = {"_GYROSCREEN_COMPLETE": "complete_zsh", "_TYPER_COMPLETE_ARGS": "gyroscreen ref"}
    paths = {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked | paths, cwd=folder, capture_output=True, text=True
    )
    answer, loaded = done.stdout.splitlines()
    assert answer.startswith('_arguments \'*: :(("refine":"')
    assert loaded == "[]"


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("gyroscreen ref", ["refine"]),
        ("gyroscreen run --deb", ["--debug"]),
        ("gyroscreen population sh", ["show"]),
        ("gyroscreen simulate out --effect cubic_s", ["cubic_stiffness"]),
        ("gyroscreen simulate out --irregularity spring_w", ["spring_width"]),
        ("gyroscreen report 2026", ["20260101-a", "20260102-b"]),
        ("gyroscreen query x --results other --run 2", ["20250101-c"]),
        ("gyroscreen run --out other --resume ", ["20250101-c", "latest"]),
        ("gyroscreen refine lot --population ", ["cloverleaf", "mine.toml"]),
        ("gyroscreen export --format wafermap", ["wafermap-csv", "wafermap-png"]),
        ("gyroscreen completion z", ["zsh"]),
    ],
)
def test_the_tab_key_offers(line, offered, folder):
    assert completions(line, folder) == offered


def test_names_are_those_of_the_library():
    assert complete.effects("") == sorted(find_effects())
    assert complete.irregularities("") == sorted(find())
    assert set(shipped()) <= set(complete.populations(""))


def test_a_completion_imports_no_numerical_package():
    code = (
        "import sys; from workflows.commands.groups import complete; import workflows.cli;"
        "complete.effects('c'); complete.irregularities('s'); complete.populations('');"
        "print([name for name in ('numpy', 'scipy', 'pyarrow', 'msgspec', 'numba') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("shell", "script"),
    [
        ("bash", ".bash_completions/gyroscreen.sh"),
        ("zsh", ".zfunc/_gyroscreen"),
        ("fish", ".config/fish/completions/gyroscreen.fish"),
    ],
)
def test_a_script_is_printed_and_installed(shell, script, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert call(["completion", shell]) == 0
    printed = capfd.readouterr().out.strip()
    assert f"_GYROSCREEN_COMPLETE=complete_{shell} " in printed
    assert call(["completion", shell, "--install"]) == 0
    assert (tmp_path / script).read_text().strip() == printed
    assert str(tmp_path / script) in capfd.readouterr().out
    assert call(["completion"]) == 0
    assert f"~/{script}" in capfd.readouterr().out


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_the_first_tab_of_a_zsh_has_an_answer(tmp_path):
    """zsh runs the file in place of the function at the first Tab: the words of the line must reach it."""
    (tmp_path / "_gyroscreen").write_text(script_of("zsh"))
    probe = (
        f"fpath=({tmp_path} $fpath); compdef() {{ }}; words=(gyroscreen ref); CURRENT=2;"
        '_arguments() { print -r -- "$@" }; autoload -U _gyroscreen; _gyroscreen'
    )
    done = subprocess.run(
        ["zsh", "-f", "-c", probe], env=with_program(tmp_path), capture_output=True, text=True, check=True
    )
    assert "refine" in done.stdout, done.stderr


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_asks_the_script(tmp_path):
    (tmp_path / "script.fish").write_text(script_of("fish"))
    asked = f"source {tmp_path}/script.fish; complete -C 'gyroscreen ref'"
    done = subprocess.run(
        ["fish", "--no-config", "-c", asked], env=with_program(tmp_path), capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("refine\t"), done.stderr


def with_program(folder: Path) -> dict[str, str]:
    """An environment in which `gyroscreen` is this package."""
    program = folder / "gyroscreen"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{ASK}" "$@"\n')
    program.chmod(0o755)
    root = str(Path(__file__).parents[2])
    return os.environ | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": root}


def test_bash_accepts_the_script_and_asks_it(folder):
    if not Path("/bin/bash").exists():
        pytest.skip("no bash")
    lines = f"""
        gyroscreen() {{ {sys.executable} -c "{ASK}" "$@"; }}
        export -f gyroscreen
        env() {{ while [[ $1 == *=* ]]; do local -x "$1"; shift; done; "$@"; }}
        source <(gyroscreen completion bash)
        COMP_WORDS=(gyroscreen diag) COMP_CWORD=1
        _gyroscreen_completion gyroscreen
        echo "${{COMPREPLY[@]}}"
        complete -p gyroscreen
    """
    paths = {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        ["/bin/bash", "--norc", "-c", lines],
        env=os.environ | paths,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split("\n")[0] == "diagnose", done.stderr
    assert "_gyroscreen_completion gyroscreen" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["tcsh"], ("tcsh", "bash, zsh, fish")), (["--install"], ("--install", "bash, zsh, fish"))],
)
def test_wrong_input_gives_one_message(arguments, words, capfd):
    assert call(["completion", *arguments]) == 2
    shown = capfd.readouterr()
    assert shown.out == ""
    assert len(shown.err.splitlines()) == 1
    for word in words:
        assert word in shown.err


def test_a_home_folder_that_cannot_be_written_gives_one_message(tmp_path, monkeypatch, capfd):
    (tmp_path / ".bash_completions").write_text("a file where the folder would be")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert call(["completion", "bash", "--install"]) == 2
    assert capfd.readouterr().err.startswith("error: the script cannot be written")
