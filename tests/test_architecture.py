"""The structure of the code: import order, no import cycles, nothing unexpected at the top level, every folder introduced."""

import ast
from collections.abc import Iterator
from functools import cache
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
#: What every part of pipeline may import.
BASE = {
    "errors",
    "input_limits",
    "arrays",
    "axial",
    "toml_files",
    "toml_keys",
    "quantities",
    "threads",
    "compiled_loops",
    "plain",
    "performance",
    "user_code",
}
#: The parts of pipeline, and the other parts that each may import.
PARTS = {
    "performance": set(),
    "device": set(),
    "experiment": {"device"},
    "identification": {"device", "experiment"},
    "inference": {"device", "experiment", "identification"},
    "criticism": set(),
    "learning": {"device", "experiment", "identification", "inference", "criticism"},
    "sql": set(),
    "store": {"sql"},
}
#: The base modules that a part is held to, where it may not have them all.
BASE_OF = {
    "performance": {"errors", "arrays"},
    "criticism": {"errors", "arrays"},
    "sql": {"errors"},
    "store": {"errors", "arrays", "quantities", "plain"},
}
#: Sub-packages of one part that do not know each other.
APART = ({"reports.run", "reports.grr", "reports.learning", "reports.paper", "reports.what_if", "reports.trend"},)
ONLY_IN_WORKFLOWS = {"dask", "distributed", "typer", "click"}
TOP = {
    "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "docs", "tests", *PACKAGES,
}  # fmt: skip
#: A folder with more files than this has a README of at most so many lines.
FILES, README_LINES = 5, 15
LONGEST = 300


def modules() -> Iterator[Path]:
    for package in PACKAGES:
        yield from sorted((ROOT / package).rglob("*.py"))


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


KNOWN = {dotted(path): path for path in modules()}


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Imports and classes of a module, at its top level or within functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return tuple(n for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom | ast.ClassDef))


@cache
def imports(path: Path) -> frozenset[str]:
    """Absolute dotted names of what a module imports."""
    here = path.relative_to(ROOT).with_suffix("").parts
    found: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            names = {f"{module}.{alias.name}" for alias in node.names}
            # A module that is imported from its package is no use of the package's own names.
            found |= names if names <= KNOWN.keys() else {module} | names
    return frozenset(found)


@pytest.mark.parametrize("path", list(modules()), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_follow_the_order_of_the_packages(path):
    package, *rest = path.relative_to(ROOT).with_suffix("").parts
    for name in imports(path):
        top, *inner = name.split(".")
        if top in PACKAGES and top != package:
            assert top in MAY_IMPORT[package], f"{package} must not import {name}"
        if top in ONLY_IN_WORKFLOWS:
            assert package == "workflows", f"{name} belongs in workflows"
        if package == top == "pipeline" and len(rest) > 1 and inner:
            part, other = rest[0], inner[0]
            allowed = PARTS[part] | BASE_OF.get(part, BASE) | {part}
            assert other in allowed, f"pipeline.{part} must not import {name}"


@pytest.mark.parametrize("family", APART, ids=lambda names: " ".join(sorted(names)))
def test_sub_packages_that_are_apart_do_not_import_each_other(family):
    for path in modules():
        own = next((one for one in family if dotted(path).startswith(f"{one}.")), None)
        for other in family - {own} if own else ():
            crossing = [name for name in imports(path) if name == other or name.startswith(f"{other}.")]
            assert not crossing, f"{dotted(path)} imports {crossing}"


def test_no_file_imports_itself_by_way_of_others():
    graph = {
        name: {known for known in map(_module_of, imports(path)) if known and known != name}
        for name, path in KNOWN.items()
    }
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, f"import cycle: {' -> '.join([*trail[trail.index(name) :], name])}"
        if name in done:
            return
        for other in sorted(graph[name]):
            visit(other, (*trail, name))
        done.add(name)

    for name in sorted(graph):
        visit(name, ())


@cache
def _module_of(name: str) -> str | None:
    """The module that an imported name lives in; an empty package file is no module."""
    while name not in KNOWN:
        name = name.rpartition(".")[0]
        if not name:
            return None
    path = KNOWN[name]
    return None if path.name == "__init__.py" and not path.read_text(encoding="utf-8").strip() else name


def test_the_top_level_holds_what_the_design_names():
    tracked = {p.name for p in ROOT.iterdir() if not p.name.startswith(".") and not p.name.endswith(".egg-info")}
    assert tracked - TOP <= {"results", "dist", "build"}


def test_at_most_five_files_are_long_and_each_says_why():
    long = []
    for path in modules():
        lines = path.read_text(encoding="utf-8").splitlines()
        if len(lines) > LONGEST:
            long.append(dotted(path))
            assert "long because" in "\n".join(lines[:40]).lower(), (
                f"{path}: {len(lines)} lines, and it does not say why"
            )
    assert len(long) <= 5, long


def test_every_folder_of_more_than_five_files_is_introduced_in_a_few_lines():
    for folder in sorted({path.parent for path in modules()}):
        files = [path for path in folder.iterdir() if path.is_file() and path.name not in ("__init__.py", "README.md")]
        if len(files) > FILES:
            readme = folder / "README.md"
            assert readme.exists(), f"{folder.relative_to(ROOT)} has {len(files)} files and no README.md"
            count = len(readme.read_text(encoding="utf-8").splitlines())
            assert count <= README_LINES, f"{readme.relative_to(ROOT)} has {count} lines"


def test_a_class_name_means_one_thing():
    where: dict[str, list[str]] = {}
    for path in modules():
        for node in nodes(path):
            if isinstance(node, ast.ClassDef):
                where.setdefault(node.name.lstrip("_"), []).append(dotted(path))
    assert not {name: files for name, files in where.items() if len(files) > 1}


def test_readme_commands_exist():
    from workflows.cli import call

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = {line.split()[1] for line in text.splitlines() if line.startswith("gyroscreen ")}
    for name in named:
        assert call([name, "--help"]) == 0
