"""The arrows of docs/architecture.md hold, and nothing stands at the top that the design does not know."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("pipeline", "populations", "reports", "workflows")
MAY_IMPORT = {
    "pipeline": set(),
    "populations": {"pipeline"},
    "reports": {"pipeline"},
    "workflows": {"pipeline", "populations", "reports"},
}
#: Inside pipeline, each part may import those to its left; store and criticism only what all may.
ORDER = (
    "errors",
    "arrays",
    "axial",
    "toml_files",
    "quantities",
    "plain",
    "threads",
    "device",
    "experiment",
    "identification",
    "inference",
    "learning",
)
SHARED = {"errors", "arrays", "axial", "toml_files", "quantities", "plain", "threads"}
ONLY_IN_WORKFLOWS = {"dask", "distributed", "typer", "click"}
TOP = {
    "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "docs", "tests", *PACKAGES,
}  # fmt: skip


def modules():
    for package in PACKAGES:
        yield from sorted((ROOT / package).rglob("*.py"))


def imports(path: Path) -> set[str]:
    """Absolute dotted names of everything that a module imports."""
    here = path.relative_to(ROOT).with_suffix("").parts
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", list(modules()), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_follow_the_arrows(path):
    package, *rest = path.relative_to(ROOT).with_suffix("").parts
    for name in imports(path):
        top, *inner = name.split(".")
        if top in PACKAGES and top != package:
            assert top in MAY_IMPORT[package], f"{package} must not import {name}"
        if top in ONLY_IN_WORKFLOWS:
            assert package == "workflows", f"{name} belongs in workflows"
        if package == top == "pipeline" and len(rest) > 1 and inner:
            part, other = rest[0], inner[0]
            if part == other or other in SHARED:
                continue
            allowed = ORDER[: ORDER.index(part)] if part in ORDER else ()
            if part == "learning":
                allowed = (*allowed, "criticism")
            assert other in allowed, f"pipeline.{part} must not import {name}"


def test_the_top_level_holds_what_the_design_names():
    tracked = {p.name for p in ROOT.iterdir() if not p.name.startswith(".") and not p.name.endswith(".egg-info")}
    assert tracked - TOP <= {"results", "dist", "build"}


def test_a_file_that_tires_a_reader_says_why():
    for path in modules():
        lines = path.read_text(encoding="utf-8").splitlines()
        if len(lines) > 400:
            assert "long because" in "\n".join(lines[:40]).lower(), (
                f"{path} has {len(lines)} lines and does not say why"
            )


def test_readme_commands_exist():
    from workflows.cli import call

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = {line.split()[1] for line in text.splitlines() if line.startswith("gyroscreen ")}
    for name in named:
        assert call([name, "--help"]) == 0
