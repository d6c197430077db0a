"""gyroscreen in Python: ``from workflows import api as gs``.

One device
    read_campaign, write_campaign, check, identify, compare, diagnose, refine, simulate
A measured lot
    read_lot, compare_lot, diagnose_lot, refine_lot, simulate_lot, load_population
A night
    run, open_run
Models, limits, effects
    load_model, load_limits, find_effects, Model
Figures and posteriors
    figures (every figure of the pages as a matplotlib Figure), inference_data (draws for ArviZ)

Calls are as short as the commands, take paths or what an earlier call returned, and raise the typed errors of
``pipeline.errors``.  Answers are immutable, print as the commands do, and give tables as pandas frames.  Names are
loaded when they are first used, so that the import takes no time.

    campaign = gs.read_campaign("campaign")
    print(gs.identify(campaign), gs.refine(campaign), sep="\\n\\n")
    night = gs.open_run(results="nightly")
    night.devices.groupby("wafer")["split_hz"].mean()
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.device.effect import find_effects
    from pipeline.device.model import Model

    from . import figures as figures
    from .draws import inference_data
    from .loop import check, compare, diagnose, identify, load_limits, load_model, read_campaign, refine
    from .loop import simulate as simulate
    from .loop import write_campaign as write_campaign
    from .lots import compare_lot, diagnose_lot, load_population, read_lot, refine_lot, simulate_lot
    from .night import ScreeningRun
    from .runs import open_run, run

__all__ = [
    "Model",
    "ScreeningRun",
    "check",
    "compare",
    "compare_lot",
    "diagnose",
    "diagnose_lot",
    "figures",
    "find_effects",
    "identify",
    "inference_data",
    "load_limits",
    "load_model",
    "load_population",
    "open_run",
    "read_campaign",
    "read_lot",
    "refine",
    "refine_lot",
    "run",
    "simulate",
    "simulate_lot",
    "write_campaign",
]

_HOME = {
    "Model": "pipeline.device.model",
    "find_effects": "pipeline.device.effect",
    "ScreeningRun": "workflows.api.night",
    "open_run": "workflows.api.runs",
    "run": "workflows.api.runs",
    "inference_data": "workflows.api.draws",
    **dict.fromkeys(
        ("compare_lot", "diagnose_lot", "load_population", "read_lot", "refine_lot", "simulate_lot"),
        "workflows.api.lots",
    ),
}


def __getattr__(name: str) -> Any:
    """A public name, loaded from its module when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "figures":
        return import_module("workflows.api.figures")
    return getattr(import_module(_HOME.get(name, "workflows.api.loop")), name)


def __dir__() -> list[str]:
    return __all__
