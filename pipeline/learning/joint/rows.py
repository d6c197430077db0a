"""The rows of all parts of a campaign, one part after the other, and their regression on the parameters of one device.

Shapes: block b (n_b, m_b); fitted blocks of all parts first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import Candidate, FitResult, Region, Signatures
from ...criticism.regression import Regression, Term
from ...errors import GyroscreenError
from .part import Part, RecordLeft, Values

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class JointRows:
    """The rows of all parts.

    Parameters
    ----------
    parts : for squares of the parameters ``even``.
    at_null : every parameter, those of the given model at their start and absent effects at their null.
    start : start values of the parameters that every fit has.
    terms : that may be added.
    sizes : for each part the typical sizes of the parameters of terms.
    even : parameters of which values hold the squares.
    limits : parameter -> range of a fit.
    """

    parts: tuple[Part, ...]
    at_null: Values
    start: Values
    terms: tuple[Term, ...]
    sizes: Sequence[Values]
    even: frozenset[str]
    limits: Mapping[str, tuple[float, float]]

    @cached_property
    def regression(self) -> Regression:
        """Least squares of the rows."""
        return Regression(
            self._predict,
            self._in_order([part.measured for part in self.parts]),
            self.start,
            self.terms,
            held=sum(part.held for part in self.parts),
            noise_known=all(part.noise.known for part in self.parts),
            strata=self._strata,
            limits=self.limits,
            slopes=self._slopes,
        )

    @property
    def _strata(self) -> tuple[IntArray, ...]:
        """Parts have strata of their own."""
        found: list[IntArray] = []
        first = 0
        for part in self.parts:
            found += [own + first for own in part.strata]
            first += 1 + max((int(own.max(initial=0)) for own in part.strata), default=-1)
        return tuple(found)

    def _in_order(self, each: Sequence[Sequence[T]]) -> tuple[T, ...]:
        """Blocks of all parts, fitted ones first."""
        fitted = [one for own, part in zip(each, self.parts) for one in own[: len(own) - part.held]]
        held = [one for own, part in zip(each, self.parts) for one in own[len(own) - part.held :]]
        return (*fitted, *held)

    def _predict(self, points: Sequence[Values]) -> list[tuple[FloatArray, ...]]:
        found = []
        for values in points:
            every = {**self.at_null, **values}
            try:
                found.append(self._in_order([part.predict(every) for part in self.parts]))
            except (GyroscreenError, np.linalg.LinAlgError):
                # No device has these parameters: a residual that no step accepts.
                found.append(tuple(np.full(block.residual.shape, 1e6) for block in self.regression.measured))
        return found

    def typical(self, k: int) -> Values:
        """Typical sizes of all parameters in part ``k``, for the steps of differences."""
        own = {name: max(abs(at), 1e-12) for name, at in self.start.items()}
        # A clip level has no size at its null; a hundredth of itself is one.
        scanned = {
            name: grid for term in self.terms if not term.has_slope for name, grid in (term.scanned or {}).items()
        }
        own |= {name: 1e-2 * grid[0] for name, grid in scanned.items()}
        sizes = self.sizes[k]
        return {**own, **sizes, **{name: sizes[name] ** 2 for name in self.even if name in sizes}}

    def _slopes(self, values: Values, names: Sequence[str]) -> list[FloatArray]:
        every = {**self.at_null, **values}
        return list(self._in_order([p.slopes(every, names, self.typical(k)) for k, p in enumerate(self.parts)]))

    def probes(self, values: Values) -> Signatures:
        """Generic shapes of each part at ``values``; those of one part are zero in the others."""
        candidates = list[Candidate]()
        every = [part.probes(values) for part in self.parts]
        width = sum(own.blocks[0].shape[1] for own in every if own.blocks)
        blocks, first = [], 0
        for part, own in zip(self.parts, every):
            for z in own.blocks:
                wide = np.zeros((z.shape[0], width))
                wide[:, first : first + z.shape[1]] = z
                blocks.append(wide)
            for one in own.candidates:
                cells = tuple(slice(c.start + first, c.stop + first) for c in one.cells)
                candidates.append(replace(one, name=f"{part.kind}: {one.name}", cells=cells))
            first += own.blocks[0].shape[1] if own.blocks else 0
        return Signatures(tuple(candidates), tuple(blocks))

    def regions(self, fit: FitResult, values: Values, what: str) -> list[Region]:
        """What each part says of its blocks of a fit: "regions" or "misfit_regions"."""
        per_row = fit.dof / max(fit.rows, 1)
        found: list[Region] = []
        first = 0
        for part in self.parts:
            count = len(part.measured) - part.held
            found += getattr(part, what)(fit.blocks[first : first + count], values, per_row)
            first += count
        return found

    def left(self, values: Values) -> list[list[RecordLeft]]:
        """What a device with ``values`` leaves of each record, by part."""
        return [part.left(values) for part in self.parts]
