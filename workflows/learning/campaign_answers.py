"""What the loop answers about a campaign: frozen objects that print as the commands do and give JSON and pandas tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pipeline.criticism.ladder import Diagnosis, Ladder, Rung, as_diagnosis
from pipeline.criticism.problem import Region
from pipeline.criticism.selection import ForwardSelection
from pipeline.inference.general.fit import CampaignFit
from pipeline.learning.campaign.hold import hold_hint, stand_ins_of
from pipeline.learning.campaign.problem import CampaignProblem
from pipeline.learning.modal.terms import GAUGES
from pipeline.learning.next_experiment.separating import Proposal, proposals, separating_text
from pipeline.learning.where.partition import CampaignPartition, campaign_partition
from pipeline.learning.where.regions import FAMILIES, FREQUENCY_KINDS, by_kind, explained_by_kind, misfit_regions
from pipeline.learning.where.rows import where_rest, where_rows, with_after

from . import tables
from .device_verdict import verdict_of
from .text import compare_text, diagnose_text, ladder_text

if TYPE_CHECKING:
    import pandas as pd


class Answer(ABC):
    """Prints as the lines of its command; in a notebook its tables follow."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, DESIGN's keys and more."""

    @abstractmethod
    def lines(self) -> list[str]:
        """What the command says."""

    @abstractmethod
    def shown(self) -> tuple[pd.DataFrame, ...]:
        """Tables of a notebook."""

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        # The text may hold names of files and effects: it goes through pandas, which escapes.
        import pandas as pd

        text = pd.DataFrame({"": self.lines()}).to_html(index=False, header=False, border=0)
        return text + tables.html(self.shown())


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Answer):
    """How well a model explains a campaign, and where it does not."""

    view: CampaignProblem

    @cached_property
    def fit(self) -> CampaignFit:
        """The fit behind it."""
        self.view.fit(())
        return self.view.campaign_fit(())

    @cached_property
    def partition(self) -> CampaignPartition:
        """The partition of the residual, from the first fit; it is the same for all models."""
        return campaign_partition(self.fit, self.view.partitions)

    def regions(self, fit: CampaignFit | None = None) -> list[Region]:
        """The residual of a fit (of this one without it) by every family."""
        conditions: Mapping[str, Mapping[str, str]] = {b.name: b.labels for b in self.view.fit(()).blocks}
        return misfit_regions(fit or self.fit, self.partition, conditions)

    @property
    def noise(self) -> dict[str, Any]:
        """sigma [V] by channel, and where it comes from."""
        noise = self.fit.noise
        return {
            "sigma": [float(s) for s in noise.sigma_v],
            "from": "residual" if noise.source == "local" else noise.source,
        }

    @property
    def where(self) -> pd.DataFrame:
        """One row a region where it fails; shares add up to one within a family."""
        return tables.where_table(self._said)

    @property
    def records(self) -> pd.DataFrame:
        """One row a record: role and error."""
        return tables.records_table(self._said)

    @property
    def parameters(self) -> pd.DataFrame:
        """One row a parameter: value, sd, unit."""
        return tables.parameters_table(self._said, self.view.model)

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, DESIGN's keys and more."""
        return dict(self._said)

    @cached_property
    def _said(self) -> dict[str, Any]:
        result = self.view.fit(())
        if not result.ok:
            return {
                "error": {},
                "relative_error": {},
                "where": [],
                "parameters": {},
                "fit_ok": False,
                "why": result.why,
            }
        fit = self.fit
        known = fit.noise.source != "local"
        regions = self.regions()
        rows = where_rows(regions, fit.noise.dof)
        return {
            "error": {k: v if known else None for k, v in fit.error.items()},
            "relative_error": dict(fit.relative_error),
            "misfit": {k: v if known else None for k, v in fit.misfit.items()},
            "noise": self.noise,
            "where": rows,
            "where_by_kind": where_rows(by_kind(regions), fit.noise.dof),
            "where_rest": where_rest(rows),
            "where_families": {f: list(FREQUENCY_KINDS) if f == "frequency" else [f] for f in FAMILIES},
            "records": {
                r.name: {
                    "role": r.role,
                    "error": r.error if known else None,
                    "error_v": fit.error_v[r.name],
                    "relative_error": r.relative_error,
                }
                for r in fit.records
            },
            "parameters": {name: list(value) for name, value in fit.parameters.items()},
            "fit_ok": fit.fit_ok,
        }

    def lines(self) -> list[str]:
        """What `gyroscreen compare` says."""
        return compare_text(self._said)

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """Where it fails, records, parameters."""
        return self.where, self.records, self.parameters


def _hints(view: CampaignProblem, terms: Sequence[str], verdict: str) -> list[str]:
    """Whether another hold would do better; where the noise is known and the model reaches it, there is nothing to ask."""
    fit, known = view.campaign_fit(terms), view.noise.source != "local"
    left = verdict in ("unknown", "fit_failed")
    if not left and (known or not stand_ins_of(fit, view.model.effects)):
        return []
    if left and known and view.model.plant.kind == "gyro" and not stand_ins_of(fit, view.model.effects):
        return []
    found = hold_hint(fit, view.campaign, view.model.effects)
    return [] if found is None else [str(found)]


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosed(Answer):
    """What a model lacks on a campaign; ``drive_files``: those of ``separating`` are being written."""

    view: CampaignProblem
    diagnosis: Diagnosis
    drive_files: bool = False

    @property
    def verdict(self) -> str:
        """adequate, effect, class, unknown or fit_failed."""
        return self.diagnosis.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Named effects."""
        return self.diagnosis.terms

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Classes of more than one member."""
        return tuple(tuple(c.members) for c in self.diagnosis.classes if len(c.members) > 1)

    @cached_property
    def separating(self) -> tuple[Proposal, ...]:
        """For every class the record that would separate it, or the best there is."""
        fit = self.diagnosis.fit_after
        return () if fit is None else proposals(self.view, fit.terms, self.diagnosis.classes)

    @property
    def candidates(self) -> pd.DataFrame:
        """One row an absent effect, the most significant first."""
        return tables.candidates_table(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, DESIGN's keys."""
        return {"separating_record": separating_text(self.separating, self.drive_files), **self.told()}

    def told(self) -> dict[str, Any]:
        """The JSON without the search for a separating record; the gauges of a gyro are invisible to any record."""
        out = self.diagnosis.to_dict()
        gauges = GAUGES if self.view.model.plant.kind == "gyro" else ()
        return {**out, "invisible": [*out["invisible"], *gauges], "hints": self.hints}

    @cached_property
    def hints(self) -> list[str]:
        """What may be wrong with the campaign rather than with the model."""
        after = self.diagnosis.fit_after
        return [] if after is None or not after.ok else _hints(self.view, after.terms, self.verdict)

    def lines(self) -> list[str]:
        """What `gyroscreen diagnose` says."""
        return diagnose_text(self.to_dict())

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """The candidates."""
        return (self.candidates,)


@dataclass(frozen=True, eq=False, repr=False)
class Refined(Answer):
    """The ladder of a campaign, with theta, split and the verdict on every rung; ``drive_files`` as in ``Diagnosed``."""

    view: CampaignProblem
    ladder: Ladder
    selection: ForwardSelection
    drive_files: bool = False

    @property
    def verdict(self) -> str:
        """That of the last rung."""
        return str(self.ladder.verdict)

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects that were added."""
        return tuple(self.ladder.terms)

    @property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """Classes of more than one member."""
        return tuple(tuple(c.members) for c in self.ladder.classes if len(c.members) > 1)

    @cached_property
    def separating(self) -> tuple[Proposal, ...]:
        """For every class the record that would separate it, or the best there is."""
        return proposals(self.view, self.effects, self.ladder.classes)

    @cached_property
    def first_look(self) -> dict[str, Any]:
        """Candidates at the first model and what no record could show, as in the JSON of a diagnosis."""
        told = Diagnosed(self.view, as_diagnosis(self.view, self.selection)).told()
        return {key: told[key] for key in ("candidates", "invisible")}

    @property
    def candidates(self) -> pd.DataFrame:
        """One row an effect that the first model lacks, the most significant first."""
        return tables.candidates_table(self.first_look)

    @property
    def before(self) -> CampaignFit:
        """The fit that the climb began with."""
        return self.view.campaign_fit(())

    @property
    def after(self) -> CampaignFit:
        """The fit that it ended with."""
        return self.view.campaign_fit(self.effects)

    @property
    def comparison(self) -> Comparison:
        """The model that the climb began with, compared."""
        return Comparison(self.view)

    @property
    def table(self) -> pd.DataFrame:
        """One row a rung: errors, theta, split, verdict."""
        return tables.ladder_table(self._said)

    @property
    def parameters(self) -> pd.DataFrame:
        """One row a parameter of the last model: value, sd, unit."""
        return tables.parameters_table(self._said, self.after.model)

    @property
    def where(self) -> pd.DataFrame:
        """Where the first model failed, and how much of that the last one explains."""
        return tables.where_table({"where": self._said.get("regions", ())})

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON, DESIGN's keys and more."""
        return dict(self._said)

    @cached_property
    def _said(self) -> dict[str, Any]:
        out: dict[str, Any] = self.ladder.to_dict()
        if not self.ladder.rungs:
            return out
        out["hints"] = _hints(self.view, self.effects, self.verdict)
        out["separating_record"] = separating_text(self.separating, self.drive_files)
        first = self.comparison
        told = first.to_dict()
        ground = first.regions()
        kinds = [row["kind"] for row in told["where_by_kind"]]
        for row, rung in zip(out["ladder"], self.ladder.rungs):
            row.update(self._judged(rung, first, ground, kinds))
        last = first.regions(self.after)
        out["regions"] = with_after(told["where"], ground, last)
        out["regions_by_kind"] = with_after(told["where_by_kind"], by_kind(ground), by_kind(last))
        out["noise"] = first.noise
        for key, fit in (("before_", self.before), ("", self.after)):
            if fit.theta_deg is not None and fit.split_hz is not None:
                out[f"theta_{key}deg"] = list(fit.theta_deg)
                out[f"split_{key}hz"] = list(fit.split_hz)
        out["parameters"] = {name: list(value) for name, value in self.after.parameters.items()}
        return out

    def _judged(self, rung: Rung, first: Comparison, ground: list[Region], kinds: list[str]) -> dict[str, Any]:
        """What one rung did: share explained by kind of region, and the verdict on the device."""
        fit = self.view.campaign_fit(rung.terms)
        more: dict[str, Any] = {
            "explained_by_kind": explained_by_kind(ground, first.regions(fit), kinds),
            "error_v": fit.error_v,
            "relative_error_validate": fit.relative_error["validate"],
        }
        device = verdict_of(fit, self.view.campaign)
        if device is not None:
            more |= {
                "verdict": device.verdict,
                "verdict_at_face": device.ungated_verdict,
                "verdict_reason": device.reason or device.failed_limits,
            }
        return more

    def lines(self) -> list[str]:
        """What `gyroscreen refine` says."""
        return ladder_text(self._said)

    def shown(self) -> tuple[pd.DataFrame, ...]:
        """The ladder, and where the first model failed."""
        return self.table, self.where
