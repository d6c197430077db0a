"""The examination of one device: a fit with the effects that its lot needs, and the scores of the other effects.

An examination is a pure function of the configuration and of its ``Request``, so it gives the same result on every worker.
Scores are those of ``pipeline.criticism``: the device's own parameters are projected out.

Shapes: N samples of a record, K columns of all candidate effects, P fitted parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.criticism.ladder import Diagnosis, diagnose
from pipeline.criticism.problem import Candidate, FitResult
from pipeline.criticism.scores import baseline, project
from pipeline.criticism.shared import SharedTerm
from pipeline.device.gyro import PHYSICAL
from pipeline.device.model import Model, mains_effects
from pipeline.errors import GyroscreenError
from pipeline.experiment.bad_samples import without_bad_samples
from pipeline.experiment.noise.level import NoiseLevel, noise_level
from pipeline.experiment.noise.lines import hum_line
from pipeline.experiment.noise.spectrum import noise_spectrum
from pipeline.experiment.record import Campaign, Record
from pipeline.inference.estimate import RateSettings
from pipeline.inference.general.fit import CampaignFit, fit_campaign
from pipeline.inference.general.goodness import band_goodness, fit_status
from pipeline.inference.general.residuals import CampaignResiduals
from pipeline.inference.screening.mismatch import NIGHTLY_MODEL
from pipeline.inference.systematic import Identified
from pipeline.learning.campaign.problem import CampaignProblem
from pipeline.learning.campaign.signatures import signature_of, tangent_of
from populations.draw import draw
from reports.decision import decide

from ...config import RunConfig
from ..campaign_source import CampaignSource
from ..settings import population, rate_of
from ..virtual_device import shared_record, virtual_records

_DRAWS, _STREAM = 400, 109

#: Configuration of the run, and the campaigns by number of the device if the devices are measured.
Source = tuple[RunConfig, Mapping[int, CampaignSource]]


@dataclass(frozen=True)
class Request:
    """A request to examine device ``number``.

    Parameters
    ----------
    number : of the device in the run.
    start : parameter and value from which the fit starts.
    terms : effects in the model in addition to the screening model.
    scored : compute scores of the effects that are not in the model.
    alone : diagnose the device by itself instead.
    """

    number: int
    start: tuple[tuple[str, float], ...]
    terms: tuple[str, ...] = ()
    scored: bool = True
    alone: bool = False


@dataclass(frozen=True, eq=False)
class DeviceExamination:
    """The result of a request.

    Parameters
    ----------
    number, terms : of the request.
    why : why the examination failed; empty if it succeeded.
    parameters : name -> (value, sd) of the fit.
    score, information, covariance : score (K,), its information and its covariance (K, K), for the columns of
        :func:`columns_of`.
    status, p_pass, verdict : with the terms in the model.
    effects, sizes, reason : the diagnosis of the device by itself, if requested.
    """

    number: int
    terms: tuple[str, ...]
    why: str
    parameters: Mapping[str, tuple[float, float]]
    score: FloatArray
    information: FloatArray
    covariance: FloatArray
    status: str = "fit_failed"
    p_pass: float = float("nan")
    verdict: str = "undecided"
    effects: str = ""
    sizes: str = ""
    reason: str = ""


@lru_cache(maxsize=8)
def columns_of(terms: tuple[str, ...]) -> tuple[SharedTerm, ...]:
    """The candidate effects and their columns, if ``terms`` are in the model.

    Effects with a parameter that is scanned on a grid are left out: it does not exist at the null.  So are those that lie inside
    an effect of the model (the up-down tilt inside the mismatch).
    """
    model = replace(NIGHTLY_MODEL, effects=(*NIGHTLY_MODEL.effects, *terms))
    found, place = [], 0
    for name in model.candidates():
        effect = model.effect(name)
        if any(other.always and set(other.effects) <= set(model.effects) for other in effect.look_alikes):
            continue
        members = effect.members(model.built.shape)
        if effect.disturbance is not None or any(m.grid for m in members):
            continue
        sides = tuple(1 if m.low == m.null else (-1 if m.high == m.null else 0) for m in members)
        found.append(SharedTerm(name, tuple(range(place, place + len(members))), sides))
        place += len(members)
    return tuple(found)


def examine_device(source: Source, request: Request) -> DeviceExamination:
    """Fit, score and judge one device; a failure is reported in ``why`` and never raised."""
    with threadpool_limits(limits=1):
        try:
            return _examined(source, request)
        except (GyroscreenError, ArithmeticError, ValueError, MemoryError, np.linalg.LinAlgError) as error:
            return failed_examination(request, f"{error}")


def failed_examination(request: Request, why: str) -> DeviceExamination:
    """The result of an examination that failed, with its reason."""
    empty = np.zeros(0)
    return DeviceExamination(request.number, request.terms, why, {}, empty, empty, empty, reason=why)


def measurement_of(source: Source, number: int) -> tuple[Campaign, NoiseLevel, float | None]:
    """Records of a device, their noise level, and the mains frequency in its model [Hz], if any."""
    config, campaigns = source
    if config.source.kind == "campaigns":
        campaign = without_bad_samples(campaigns[number].read())
        silent = campaign.with_role("noise")
        line = hum_line(silent[0].sense_v, campaign.instrument.sample_rate_hz) if silent else None
        return campaign, noise_level(campaign, line), line
    spec = population(config)
    drawn = draw(spec, config.run.seed, number, 1)
    instrument, shared = config.instrument.instrument(), shared_record(config).record
    silent_v, fit_v, _ = virtual_records(config, drawn, 0)
    rate, line = instrument.sample_rate_hz, config.line_hz()
    spectrum = noise_spectrum(silent_v, rate, line, instrument.adc)
    level = NoiseLevel(spectrum.sigma_v, "silent", spectrum.dof, spectrum=None if spectrum.white else spectrum)
    records = (
        Record("silence", rate, np.zeros((silent_v.shape[0], 2)), silent_v, role="noise"),
        Record("chirp", rate, shared.drive_v, fit_v, role="fit"),
    )
    gain = float(spec.angular_gain)
    return Campaign(drawn.device_id[0], records, instrument, gain), level, line


def nightly_model(line: float | None, start: Sequence[tuple[str, float]]) -> tuple[Model, dict[str, float]]:
    """The model of the nightly fit with hum lines at ``line`` [Hz], if any, and its start from the parameters of a device."""
    hum = mains_effects() if line else {}
    model = replace(NIGHTLY_MODEL, effects=(*NIGHTLY_MODEL.effects, *hum))
    return model, dict(start) | (dict.fromkeys(hum.values(), line) if line else {})


def _examined(source: Source, request: Request) -> DeviceExamination:
    config, _ = source
    campaign, noise, line = measurement_of(source, request.number)
    model, start = nightly_model(line, request.start)
    score, information, covariance = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    effects = sizes = reason = ""
    if request.scored or request.alone:
        view = CampaignProblem(campaign, model, noise)
        first = FitResult(True, (), {name: (value, 0.0) for name, value in start.items()}, (), ())
        fit = view.fit(request.terms, first)
        if not fit.ok:
            return failed_examination(request, fit.why or "the fit with these effects did not converge")
        fitted = view.campaign_fit(request.terms)
        if request.alone:
            effects, sizes, reason = diagnosis_texts(diagnose(view, request.terms))
        else:
            score, information, covariance = _scores(view, fitted, fit, columns_of(request.terms))
    else:
        fitted = fit_campaign(replace(model, effects=(*model.effects, *request.terms)), campaign, noise, start)
    rate = rate_of(config, campaign.angular_gain)
    status, p_pass, verdict = _judged(config, campaign, fitted, rate, request.number)
    return DeviceExamination(
        request.number,
        request.terms,
        "",
        fitted.parameters,
        score,
        information,
        covariance,
        status,
        p_pass,
        verdict,
        effects,
        sizes,
        reason,
    )


def _scores(
    view: CampaignProblem, fitted: CampaignFit, fit: FitResult, terms: Sequence[SharedTerm]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Score (K,), information and covariance (K, K) of the columns of ``terms``, in the units of their parameters."""
    problem = CampaignResiduals(fitted.model, view.campaign, view.noise)
    tasks = problem.tasks(view.records, fitted.values)

    def rows(place: int, y: FloatArray) -> FloatArray:
        return view.spectra[place](problem.whiten(y, tasks.each[place])).reshape(y.shape[0], -1)

    tangent = tangent_of(fitted, tasks, view.campaign.instrument, view.records, rows)
    width = sum(len(term.columns) for term in terms)
    blocks = [np.zeros((width, part.rows.size)) for part in fit.blocks]
    for term in terms:
        found: tuple[Candidate, list[list[FloatArray]]] | None = signature_of(tangent, term.name)
        if found is not None and len(found[0].parameters) == len(term.columns):
            for block, own in zip(blocks, found[1]):
                block[list(term.columns)] = np.concatenate(own)
    projected = project(baseline(fit), [block.T for block in blocks])
    norms = projected.norms
    both = np.outer(norms, norms)
    return projected.score * norms, projected.gram * both, projected.covariance * both


def _judged(
    config: RunConfig, campaign: Campaign, fitted: CampaignFit, rate: RateSettings, number: int
) -> tuple[str, float, str]:
    """Status, P(conform) and verdict of a fit, from the gate and the limits of the run and normal draws."""
    band = config.identification
    goodness = band_goodness(fitted, campaign, band.low_hz, band.high_hz)
    status, _ = fit_status(fitted, campaign, goodness, config.judging_gate())
    random = np.random.default_rng(np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM, number)))
    size = np.sqrt(np.maximum(np.diag(fitted.x_covariance), 1e-300))
    value, vector = np.linalg.eigh(fitted.x_covariance / np.outer(size, size))
    root = size[:, None] * vector * np.sqrt(np.maximum(value, 0.0))
    x = fitted.x + random.standard_normal((_DRAWS, size.size)) @ root.T
    values = {name: np.full(_DRAWS, value) for name, value in fitted.model.to_values(fitted.x).items()}
    values |= dict(zip(fitted.model.free, fitted.model.declared(x).T))
    physical = np.stack([values.get(name, np.zeros(_DRAWS)) for name in PHYSICAL], axis=1)
    draws = Identified.of_physical(physical, rate).draws
    limits = config.judged_by()
    decision = decide(limits, {q: draws[q][None] for q in limits.quantities}, [status])
    return status, float(decision.p_pass[0]), decision.verdict[0]


def diagnosis_texts(found: Diagnosis) -> tuple[str, str, str]:
    """Effects (members of a class joined by |), their sizes, and the reason, as the devices table states them."""
    if found.verdict in ("effect", "class"):
        members = {item.term: item.members for item in found.classes}
        effects = "+".join("|".join(members.get(term, (term,))) for term in found.terms)
        fit = found.fit_after
        sizes = "" if fit is None else sizes_of(fit.parameters, found.terms)
        return effects, sizes, f"{found.verdict}: explains the misfit"
    if found.verdict == "adequate":
        return "", "", "adequate: no effect is significant and the residual has no structure"
    if found.verdict == "fit_failed":
        return "unknown", "", f"fit_failed: {found.why}"
    best = found.scores[0] if found.scores else None
    parts = ["no known effect explains the misfit"]
    if found.left:
        parts.append(f"the residual has structure: {found.left}")
    if best is not None:
        parts.append(f"closest candidate {best.name}, which lowers chi2 by {best.delta_chi2:.3g}")
    return "unknown", "", "; ".join(parts)


def sizes_of(parameters: Mapping[str, tuple[float, float]], terms: Sequence[str]) -> str:
    """Sizes of the parameters of the effects ``terms``, as text "effect.parameter=value+-sd, .."."""
    own = [(n, v, sd) for n, (v, sd) in parameters.items() if n.partition(".")[0] in terms and "." in n]
    return ", ".join(f"{name}={value:.4g}+-{sd:.2g}" for name, value, sd in own)
