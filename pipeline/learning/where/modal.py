"""Where a model fails on a modal record: every entry of every mode, measured and modelled."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import convert

from ...criticism.ladder import Ladder
from ...criticism.problem import FitResult
from ..answers import Place
from ..modal.problem import ModalProblem


def entries_by_misfit(problem: ModalProblem, fit: FitResult) -> tuple[Place, ...]:
    """Every entry with its share of the squared misfit, the largest first; relative to the norm of its mode."""
    values = {name: value for name, (value, _) in fit.parameters.items()}
    residual, model = problem.residuals(fit), problem.modes(values).c
    squared = np.abs(residual) ** 2
    regions = dict(zip(np.ndindex(squared.shape), problem.regions(fit)))
    places = []
    for entry in sorted(regions, key=lambda entry: float(-squared[entry])):
        region, norm = regions[entry], problem.norms[entry[0]]
        measured, modelled = complex(problem.measured.c[entry] / norm), complex(model[entry] / norm)
        places.append(
            _place(
                region.labels,
                share=float(squared[entry] / max(float(squared.sum()), 1e-300)),
                error=float(np.sqrt(region.chi2 / region.dof)) if problem.noise_known else None,
                relative_error=float(np.abs(residual[entry])),
                measured=(measured.real, measured.imag),
                model=(modelled.real, modelled.imag),
            )
        )
    return tuple(places)


def explained_entries(ladder: Ladder) -> tuple[Place, ...]:
    """Entries where the first model of a ladder fails, with the share of the excess that the last one explains."""
    return tuple(_place(w.labels, share=w.share, error=w.error, explained=share) for w, share in ladder.regions)


def _place(labels: Mapping[str, object], **values: object) -> Place:
    return convert({**labels, "kind": "resonance", **values}, Place)
