"""A problem without some of its candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.criticism.problem import FitResult, Problem, Region, Signatures, Spectrum


class RestrictedProblem:
    """The problem ``whole`` without the candidates ``left_out``."""

    def __init__(self, whole: Problem, left_out: Sequence[str]) -> None:
        self.whole = whole
        self.left_out = frozenset(left_out)

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """As in the whole problem."""
        return self.whole.fit(terms, start)

    def signatures(self, fit: FitResult) -> Signatures:
        """The signatures of the whole problem without the candidates that are left out."""
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
