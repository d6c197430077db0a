"""The page of the Python interface: what it lists, for Sphinx to fill from signatures and docstrings."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any, get_args, get_type_hints

from pipeline import errors
from pipeline.errors import GyroscreenError

from .. import api
from .markdown import NOTE, code, table, without_roles

_OWN = ("pipeline.", "populations.", "reports.", "workflows.")
_ABOUT = """\
# Python interface

```python
from workflows import api as gs
```

One import has everything. Calls take paths or what an earlier call returned. Answers are immutable and print as the commands
do; their tables are pandas frames. `docs/tutorials/notebook.md` shows the interface in use. Names below are those of `gs`.
"""


def python_page() -> str:
    """Markdown of the page: functions, what they return, figures, errors."""
    functions = [name for name in api.__all__ if inspect.isfunction(getattr(api, name))]
    listed = [(f"[`gs.{name}`](#{_anchor(getattr(api, name))})", _summary(getattr(api, name))) for name in functions]
    figures = [figure.__name__ for figure in public_functions(api.figures)]
    parts = [
        NOTE,
        _ABOUT,
        "## Functions\n",
        table(("function", "what it does"), listed),
        *(_directive("autofunction", getattr(api, name)) for name in functions),
        "## What they return\n",
        *(_directive("autoclass", kind, ":members:", ":inherited-members: object") for kind in public_classes()),
        "## Figures\n",
        f"{' '.join((api.figures.__doc__ or '').split(';')[0].split())} (`gs.figures`).\n",
        *(_directive("autofunction", getattr(api.figures, name)) for name in figures),
        "## Errors\n",
        "Every fault of an input is one typed error of `pipeline.errors` with the exit code that the commands return.\n",
        table(
            ("error", "exit code", "meaning"), [(code(e.__name__), str(e.exit_code), _summary(e)) for e in errors_()]
        ),
    ]
    return "\n".join(parts)


def public_functions(module: Any) -> list[Callable[..., Any]]:
    """The functions that a module itself defines, in the order of the file."""
    own = [f for _, f in inspect.getmembers(module, inspect.isfunction) if f.__module__ == module.__name__]
    return sorted((f for f in own if not f.__name__.startswith("_")), key=lambda f: f.__code__.co_firstlineno)


def public_classes() -> list[type]:
    """The classes that the interface names or its functions return, each once, in the order in which they appear."""
    found: dict[type, None] = {}
    for name in api.__all__:
        value = getattr(api, name)
        if isinstance(value, type):
            found[value] = None
        elif inspect.isfunction(value):
            found |= dict.fromkeys(_own_classes(get_type_hints(inspect.unwrap(value)).get("return")))
    return sorted(found, key=lambda kind: kind.__name__)


def errors_() -> list[type[GyroscreenError]]:
    """The typed errors, by exit code."""
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, GyroscreenError)]
    return sorted(
        (kind for kind in kinds if kind is not GyroscreenError), key=lambda kind: (kind.exit_code, kind.__name__)
    )


def _own_classes(hint: Any) -> Iterator[type]:
    """Classes of gyroscreen in an annotation."""
    if isinstance(hint, type) and hint.__module__.startswith(_OWN) and not get_args(hint):
        yield hint
    for inner in get_args(hint):
        yield from _own_classes(inner)


def _directive(kind: str, value: Any, *options: str) -> str:
    lines = [f".. {kind}:: {_full_name(value)}", *(f"   {option}" for option in options)]
    return "```{eval-rst}\n" + "\n".join(lines) + "\n```\n"


def _full_name(value: Any) -> str:
    return f"{inspect.unwrap(value).__module__}.{value.__qualname__}"


def _anchor(value: Any) -> str:
    return _full_name(value)


def _summary(value: Any) -> str:
    return without_roles(" ".join(inspect.cleandoc(value.__doc__ or "").split("\n\n")[0].split()))
