"""Posterior draws as ArviZ ``InferenceData``, which is an ``xarray.DataTree`` since ArviZ 1.0; see :mod:`workflows.api`.

Groups: ``posterior`` (chain, draw) by quantity, with the unit in the attributes of each variable; ``constant_data`` with the true
values of a virtual device.  The attribute ``draws_from`` says what the draws are.  A "/" in a name becomes "_per_".

Groups and dimensions follow the InferenceData schema of ArviZ (python.arviz.org/projects/base, "from_dict").
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ConfigError, UsageError
from pipeline.inference.general.fit import CampaignFit
from pipeline.quantities import QUANTITIES

from ..device.identified import IdentifiedDevice
from ..learning import ComparisonResult, RefinementResult

_UNITS = {quantity.name: quantity.unit for quantity in QUANTITIES}
_DRAWS = 4000
_STORED, _SAMPLED, _NORMAL = (
    "draws that the run stored, thinned, all chains in one",
    "posterior draws of the identification, all chains in one",
    "normal distribution with the estimates and the covariance of the fit",
)


@runtime_checkable
class HasDraws(Protocol):
    """A run, which keeps draws of its devices."""

    def draws_of(self, device_id: str) -> tuple[dict[str, FloatArray], dict[str, float]]:
        """Draws by quantity, and true values."""


def inference_data(
    source: HasDraws | IdentifiedDevice | ComparisonResult | RefinementResult | CampaignFit,
    device_id: str | None = None,
    *,
    seed: int = 1,
) -> Any:
    """Posterior draws for ArviZ, as an ``xarray.DataTree``.

    Parameters
    ----------
    source : a stored run; what ``identify`` found; the fit of ``compare``, or the last fit of ``refine`` (4000 normal draws).
    device_id : the device of a run.
    seed : of the normal draws.

    Raises
    ------
    ConfigError : ArviZ is not installed.
    UsageError : no such device, no draws, or a fit that does not determine its parameters.

    Example
    -------
    >>> found = gs.inference_data(night, "D000003")
    >>> found.posterior["theta_deg"].std()
    """
    if isinstance(source, HasDraws):
        draws, truth = source.draws_of(device_id or "")
        return _tree(draws, truth, _STORED)
    if device_id is not None:
        raise UsageError("a device_id applies to a run only", value=device_id, next_step="leave it out")
    if isinstance(source, IdentifiedDevice):
        if not source.draws:
            raise UsageError(
                "there are no posterior draws: the measurement was fitted by least squares",
                value=source.name,
                allowed="a campaign with two drives and two senses, at rest, with its noise measured, and no model given",
                next_step="gs.inference_data(gs.compare(campaign)) draws from the covariance of the fit",
            )
        return _tree(source.draws, {}, _SAMPLED)
    fit = source if isinstance(source, CampaignFit) else _fit(source)
    return _tree(_normal(fit, seed), {}, _NORMAL, {name: p.unit for name, p in fit.model.parameters()})


def _fit(result: ComparisonResult | RefinementResult) -> CampaignFit:
    found = result.after if isinstance(result, RefinementResult) else result.fit
    if not isinstance(found, CampaignFit):
        raise UsageError(
            "only fits of time records have draws for ArviZ",
            value=type(found).__name__,
            allowed="a campaign of time records",
            next_step="the parameters and their sd are in .parameters",
        )
    return found


def _normal(fit: CampaignFit, seed: int) -> dict[str, FloatArray]:
    """(n,) draws of each free parameter from N(values, covariance)."""
    if not fit.fit_ok or not np.all(np.isfinite(fit.covariance)):
        raise UsageError(
            "the fit does not determine every parameter, so it has no posterior",
            value=", ".join(fit.names),
            allowed="a fit with fit_ok",
            next_step="gs.check the campaign, or start from another model",
        )
    centre = np.array([fit.values[name] for name in fit.names])
    random = np.random.default_rng(seed)
    # Parameters differ by twenty orders of magnitude; in units of their sd the eigenvalues are of one size.
    sd = np.sqrt(np.diag(fit.covariance))
    whitened = fit.covariance / np.outer(sd, sd)
    values = centre + sd * random.multivariate_normal(np.zeros(sd.size), whitened, _DRAWS, method="eigh")
    return dict(zip(fit.names, values.T, strict=True))


def _tree(
    draws: Mapping[str, FloatArray], truth: Mapping[str, float], draws_from: str, units: Mapping[str, str] | None = None
) -> Any:
    try:
        from arviz_base import from_dict
    except ImportError:
        raise ConfigError(
            "posteriors for ArviZ need the package arviz-base, which is not installed",
            allowed="the extra [arviz]",
            next_step='pip install "gyroscreen[arviz]"',
        ) from None
    known_draws = {name: values for name, values in draws.items() if np.isfinite(values).any()}
    # xarray reads "/" in a name as a path.
    stored = {name: name.replace("/", "_per_") for name in known_draws}
    groups = {"posterior": {stored[name]: np.asarray(values)[None] for name, values in known_draws.items()}}
    groups |= {"constant_data": {name: np.asarray(value) for name, value in truth.items()}} if truth else {}
    tree = from_dict(groups)
    known = _UNITS | {stored.get(name, name): unit for name, unit in (units or {}).items()}
    for group in groups:
        for name in groups[group]:
            tree[group][name].attrs["unit"] = known.get(name.removeprefix("true_"), "")
    tree["posterior"].attrs["draws_from"] = draws_from
    return tree
