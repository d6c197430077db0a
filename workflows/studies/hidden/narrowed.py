"""A campaign seen with a smaller library: what is left out is never a candidate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.criticism.problem import FitResult, Problem, Region, Signatures, Spectrum


class Narrowed:
    """The problem ``whole`` without the candidates named ``left_out``."""

    def __init__(self, whole: Problem, left_out: Sequence[str]) -> None:
        self.whole = whole
        self.left_out = frozenset(left_out)

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """As in the whole problem."""
        return self.whole.fit(terms, start)

    def signatures(self, fit: FitResult) -> Signatures:
        """Those of the whole problem, less what is left out."""
        found = self.whole.signatures(fit)
        kept = tuple(candidate for candidate in found.candidates if candidate.name not in self.left_out)
        local = tuple(candidate for candidate in found.local if candidate.name not in self.left_out)
        return replace(found, candidates=kept, local=local)

    def probes(self, fit: FitResult) -> Signatures:
        """As in the whole problem."""
        return self.whole.probes(fit)

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """As in the whole problem."""
        return self.whole.regions(fit)

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """As in the whole problem."""
        return self.whole.spectrum(fit)
