"""Effects at a parameter value, and a short record, for tests that every effect inherits."""

import re
from pathlib import Path

import numpy as np

from pipeline.device.effect import Effect, find_effects
from pipeline.device.model import Model
from pipeline.experiment.excitation import Chirp, drive_samples
from pipeline.experiment.instrument import AntiAlias, Instrument
from pipeline.experiment.record import Record

#: Names of all effects of the library; the tests also cover the user's effect of docs/how-to/add-an-effect.md.
LIBRARY = tuple(find_effects())
USERS = "squeeze_film"
INSTRUMENT = Instrument(antialias=AntiAlias())
_DRIVE = drive_samples(Chirp((500.0, 620.0), (620.0, 500.0), (2.0, 2.0), 0.1), 10_000.0)
RECORD = Record("chirp", 10_000.0, _DRIVE, np.zeros_like(_DRIVE))


def example_file() -> str:
    """The effect file that docs/how-to/add-an-effect.md shows."""
    text = (Path(__file__).parents[1] / "docs" / "how-to" / "add-an-effect.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", text, re.S)
    assert block is not None
    return block[1]


def is_scanned(effect: Effect) -> bool:
    """Whether all parameters are scanned, so that the record has no derivative at the null."""
    return all(parameter.grid for parameter in effect.parameters)


def values_at(effect: Effect, model: Model, share: float) -> dict[str, float]:
    """Parameters at ``share`` of their scale; those with a grid at its middle."""
    return {
        effect.full_name(m): m.grid[len(m.grid) // 2] if m.grid else m.null + share * m.scale
        for m in effect.members(model.built.shape)
    }
