"""gyroscreen simulate, effects, model."""

from __future__ import annotations

import json as json_
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.device.effect import Effect, find_effects
from pipeline.device.model import Model, load_model
from pipeline.errors import ConfigError, UsageError, unwritable
from pipeline.experiment.campaign import read_measurement, write_campaign
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.record import Campaign
from pipeline.inference.gate import Gate
from pipeline.inference.screening.campaign import identify_campaign
from pipeline.inference.screening.device import IdentificationSettings
from pipeline.inference.screening.sample import SamplerSettings

from ..export import exported, write_model
from ..simulate import campaign_config, parse_values
from ..simulate import simulate as virtual

_SEED = 1


def simulate(
    out: Path, config: Path | None, device: str, effects: Sequence[str], seed: int, folders: Sequence[Path]
) -> None:
    """See ``gyroscreen simulate --help``."""
    simulated = virtual(campaign_config(config), parse_values(device), effects, seed, [str(f) for f in folders])
    campaign = simulated.campaign
    write_campaign(campaign, out)
    truth = {"effects": list(simulated.model.effects), "parameters": simulated.parameters, "seed": seed}
    try:
        (out / "truth.json").write_text(json_.dumps(truth, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise unwritable("truth.json", out, error) from None
    print(f"{out}: {len(campaign.records)} records of {campaign.device_id}; the true parameters are in truth.json")


def effects(name: str | None, folders: Sequence[Path]) -> None:
    """See ``gyroscreen effects --help``."""
    library = find_effects(tuple(folders))
    if name is None:
        width = max(map(len, library))
        for key, effect in library.items():
            print(f"{key:{width}}  {effect.law}")
        return
    if name not in library:
        raise ConfigError(
            "no such effect", value=name, allowed=", ".join(library), next_step="list all: gyroscreen effects"
        )
    print(_described(library[name]))


def _described(effect: Effect) -> str:
    lines = [
        effect.name,
        f"  law        {effect.law}",
        f"  source     {effect.source}",
        f"  signature  {effect.signature}",
        f"  stages     {', '.join(effect.stages)}",
        f"  plants     {', '.join(effect.plants)}",
    ]
    if effect.look_alikes:
        lines.append(f"  looks like {'; '.join(' with '.join(like.effects) for like in effect.look_alikes)}")
    for p in effect.parameters:
        lines.append(f"  {p.name:10s} {p.meaning} [{p.unit}], {p.low:g} to {p.high:g}, null {p.null:g}")
    return "\n".join(lines)


def show(path: Path) -> None:
    """See ``gyroscreen model show --help``."""
    model = load_model(path)
    print(model.to_toml().rstrip())
    for name, p in model.parameters():
        print(f"# {name:40s} [{p.unit}] {p.meaning}")


def change(effect: str, path: Path, add: bool, folders: Sequence[Path]) -> None:
    """Add or drop an effect; ``add`` creates the file."""
    if not path.exists() and not add:
        raise ConfigError("no such model file", value=str(path), next_step="create it: gyroscreen model add EFFECT")
    model = load_model(path) if path.exists() else Model()
    known = (*model.effect_folders, *(str(folder) for folder in folders))
    if known != model.effect_folders:
        model = replace(model, effect_folders=tuple(dict.fromkeys(known)))
    changed = model.with_effect(effect) if add else model.without_effect(effect)
    try:
        path.write_text(changed.to_toml(), encoding="utf-8")
    except OSError as error:
        raise unwritable("the model file", path, error) from None
    print(f"{path}: effects = {', '.join(changed.effects) or 'none'}")


def export(measurement: Path, out: Path | None) -> None:
    """See ``gyroscreen model export --help``."""
    found = read_measurement(measurement)
    if isinstance(found, ModalRecord):
        raise UsageError(
            "a modal record is already a model",
            value=str(measurement),
            allowed="a campaign folder or a record file",
            next_step="export a campaign",
        )
    if not isinstance(found, Campaign):
        raise UsageError(
            "only models of time records are exported",
            value=str(measurement),
            allowed="a campaign of time records, or a record file",
            next_step="gyroscreen identify gives the parameters of a sweep or a frequency response",
        )
    if not found.with_role("fit"):
        found = replace(found, records=tuple(replace(r, role="fit") for r in found.records))
    result = identify_campaign(
        found, IdentificationSettings(), SamplerSettings(), Gate(), np.random.SeedSequence(_SEED)
    )
    path = out or Path(f"{found.device_id}.json")
    write_model(exported(found, result), path)
    print(path)
