"""One measured device: read, check, identify, compare, diagnose, refine, simulate; see :mod:`workflows.api`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.device.model import load_model as read_model
from pipeline.experiment import campaign as campaigns
from pipeline.experiment.record import Campaign
from reports import limits as limit_files
from reports.limits import Limits

from .. import learning
from ..device.checked import CheckedCampaign, checked
from ..device.identified import IdentifiedDevice, identified
from ..device.measured import Measured, with_its_campaign
from ..learning import ComparisonResult, DiagnosisResult, RefinementResult
from ..simulate import Simulated, campaign_config
from ..simulate import simulate as simulated

Source = Measured | str | Path
GivenModel = Model | str | Path | None
GivenLimits = Limits | Mapping[str, Any] | str | Path | None


def read_campaign(path: str | Path) -> Measured:
    """The measurement at ``path``: a campaign folder, its campaign.toml, one record, or a modal record (TOML).

    A record that a campaign.toml beside it lists gets that campaign's instrument and silent records.

    Raises
    ------
    ConfigError : a wrong key or value in campaign.toml.
    MeasurementError : a file is missing or is not a record.

    Example
    -------
    >>> campaign = gs.read_campaign("campaign")
    >>> campaign.device_id, len(campaign.records)
    """
    return with_its_campaign(Path(path))


def write_campaign(campaign: Campaign, folder: str | Path) -> None:
    """Write a campaign as a folder with campaign.toml and one Parquet file per record.

    Raises
    ------
    UsageError : the folder cannot be written.
    """
    campaigns.write_campaign(campaign, Path(folder))


def load_model(path: str | Path) -> Model:
    """The model of a model file (TOML); ``ConfigError`` for a wrong key or value."""
    return read_model(Path(path))


def load_limits(limits: str | Path | Mapping[str, Any]) -> Limits:
    """Limits of a TOML file, or of a table: ``{"limits": {"split_hz": {"max": 3.0}}}`` with limits in the unit of the quantity.

    Raises
    ------
    ConfigError : an unknown key, rule or quantity; limits that are empty or crossed.
    """
    return limit_files.load_limits(Path(limits) if isinstance(limits, str) else limits)


def check(campaign: Source) -> CheckedCampaign:
    """Check a campaign before any fit: polarity, swapped channels, lag, offset, clipping, hum, clock.

    The answer prints as ``gyroscreen check`` does; ``findings`` and ``levels`` [V] are tables, ``toml`` the correction.

    Raises
    ------
    ConfigError, MeasurementError : the measurement cannot be read.
    UsageError : a modal record, which has no samples.

    Example
    -------
    >>> gs.check("campaign").findings[["severity", "record", "text"]]
    """
    return checked(_measured(campaign))


def identify(
    campaign: Source, model: GivenModel = None, limits: GivenLimits = None, *, seed: int = 1
) -> IdentifiedDevice:
    """Identify one device: theta [deg], split [Hz] and the other quantities, each with its sd.

    Parameters
    ----------
    campaign : what :func:`read_campaign` returned, or a path.
    model : model or model file; by default the model of the screening run.
    limits : judge the device by these: limits, a file or a table; by default it is not judged.
    seed : of the posterior draws.

    Raises
    ------
    ConfigError, MeasurementError : the measurement cannot be read, or a model that does not apply to it.
    UsageError : limits for a modal record.

    Example
    -------
    >>> found = gs.identify("campaign")
    >>> found.quantities.loc["theta_deg", ["value", "sd"]]
    """
    own = None if model is None else _model(model, ())
    # A context, because the decorator would hide the types of the call.
    with threadpool_limits(limits=1):
        return identified(_measured(campaign), own, given_limits(limits), seed)


def compare(
    campaign: Source,
    model: GivenModel = None,
    limits: GivenLimits = None,
    *,
    effect_folders: Sequence[str | Path] = (),
) -> ComparisonResult:
    """How well a model explains a measurement, and where it fails.

    Parameters
    ----------
    campaign : what :func:`read_campaign` returned, or a path.
    model : model or model file; by default the paper's own model.
    limits : judge the device by these: limits, a file or a table.
    effect_folders : folders with your own effects.

    Raises
    ------
    ConfigError, MeasurementError : the measurement cannot be read, or a model that does not apply to it.

    Example
    -------
    >>> gs.compare("campaign").where
    """
    return learning.compare(_measured(campaign), _model(model, effect_folders), given_limits(limits))


def diagnose(
    campaign: Source,
    model: GivenModel = None,
    limits: GivenLimits = None,
    *,
    effect_folders: Sequence[str | Path] = (),
) -> DiagnosisResult:
    """Which effect the model lacks, or that no known effect explains the misfit; takes and raises what :func:`compare` does.

    Example
    -------
    >>> gs.diagnose("campaign").candidates
    """
    return learning.diagnose(_measured(campaign), _model(model, effect_folders), given_limits(limits))


def refine(
    campaign: Source,
    model: GivenModel = None,
    limits: GivenLimits = None,
    *,
    effect_folders: Sequence[str | Path] = (),
) -> RefinementResult:
    """The ladder: effects are added and refitted until no further one is significant; takes and raises what :func:`compare` does.

    Example
    -------
    >>> gs.refine("campaign").table[["effect", "error_fit", "error_validate", "theta_deg", "theta_deg_sd"]]
    """
    return learning.refine(_measured(campaign), _model(model, effect_folders), given_limits(limits))


def simulate(
    device: Mapping[str, float] | None = None,
    effects: Sequence[str] = (),
    *,
    seed: int = 1,
    config: str | Path | None = None,
    effect_folders: Sequence[str | Path] = (),
) -> Simulated:
    """The standard campaign of one virtual device, with its true parameters.

    Parameters
    ----------
    device : plant parameters by name, each in its unit, that replace those of the drawn device (``{"theta_deg": 12.0}``).
    effects : "NAME" or "NAME:param=value,.."; sizes that are not given have an SNR of 300.
    seed : of the device, the sizes and the noise.
    config : run configuration with instrument, noise and hum; by default the shipped one.
    effect_folders : folders with your own effects.

    Raises
    ------
    ConfigError : an unknown effect or parameter.

    Example
    -------
    >>> made = gs.simulate({"split_hz": 1.5}, ["cubic_stiffness"])
    >>> gs.refine(made.campaign).effects, made.parameters["cubic_stiffness.k3"]
    """
    chosen = campaign_config(None if config is None else Path(config))
    return simulated(chosen, device or {}, effects, seed, [str(folder) for folder in effect_folders])


def _measured(campaign: Source) -> Measured:
    return read_campaign(campaign) if isinstance(campaign, str | Path) else campaign


def _model(model: GivenModel, folders: Sequence[str | Path]) -> Model:
    found = load_model(model) if isinstance(model, str | Path) else model or DEFAULT_COMPARE_MODEL
    known = dict.fromkeys((*found.effect_folders, *(str(folder) for folder in folders)))
    return replace(found, effect_folders=tuple(known))


def given_limits(limits: GivenLimits) -> Limits | None:
    """Limits that a call takes: an object, a file or a table; ``None`` stays."""
    return limits if limits is None or isinstance(limits, Limits) else load_limits(limits)
