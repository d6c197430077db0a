"""Where a model fails on a modal record: every entry of every mode, measured and modelled."""

from __future__ import annotations

import numpy as np

from ...criticism.problem import FitResult
from ..modal.problem import ModalProblem


def entries_by_misfit(view: ModalProblem, fit: FitResult) -> list[dict[str, object]]:
    """Every entry with its share of the squared misfit, the largest first."""
    values = {name: value for name, (value, _) in fit.parameters.items()}
    rest, model = view.residuals(fit), view.modes(values).c
    squared = np.abs(rest) ** 2
    regions = dict(zip(np.ndindex(squared.shape), view.regions(fit)))
    told: list[dict[str, object]] = []
    for place in sorted(regions, key=lambda place: float(-squared[place])):
        c, norm, region = view.measured.c[place], view.norms[place[0]], regions[place]
        told.append(
            {
                **region.labels,
                "kind": "resonance",
                "share": float(squared[place] / max(float(squared.sum()), 1e-300)),
                "error": float(np.sqrt(region.chi2 / region.dof)) if view.noise_known else None,
                "relative_error": float(np.abs(rest[place])),
                "measured": [float((c / norm).real), float((c / norm).imag)],
                "model": [float((model[place] / norm).real), float((model[place] / norm).imag)],
            }
        )
    return told
