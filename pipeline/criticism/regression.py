"""A ``Problem`` from any function: nonlinear least squares of measured blocks on a model with optional terms.

    r_b = (y_b - f_b(p)) / sigma_b,    p^ = argmin sum_b |r_b|^2,    parameters of absent terms stay at their null

f is any function of named parameters that returns blocks: poles and residues of a modal record, lot means of a population, or a
polynomial.  Shapes: block b is (n_b, m_b); its jacobian is (n_b m_b, P).  Blocks are in units of their sd.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from .problem import Candidate, FitResult, Region, ResidualBlock, Signatures, Spectrum, TermParameter

#: Best points of a scan that become starts of a fit.
STARTS = 3

Values = Mapping[str, float]
Predict = Callable[[Sequence[Values]], Sequence[Sequence[FloatArray]]]


@dataclass(frozen=True)
class Term:
    """An optional term.

    Parameters
    ----------
    name : of the term.
    parameters : those with a null.
    scanned : parameter that does not exist at the null -> values to try.  A parameter that is among ``parameters`` too, such as a
        clip level, has no slope at its null: its column is the change from there to each value.
    fitted : scanned parameters that are fitted beyond the values that are tried; others stay between these.
    """

    name: str
    parameters: tuple[TermParameter, ...]
    scanned: Mapping[str, tuple[float, ...]] | None = None
    fitted: frozenset[str] = frozenset()

    @property
    def has_slope(self) -> bool:
        """Whether the prediction has a slope at the null."""
        return not {p.name for p in self.parameters} <= (self.scanned or {}).keys()


@dataclass(frozen=True, eq=False)
class Regression:
    """A problem for ``diagnose`` and ``refine``.

    Parameters
    ----------
    predict : points of the parameters -> for each point and block its prediction (n_b, m_b) in units of its sd, held-out blocks
        last.
    measured : the blocks in the same order; their ``residual`` is the measured value in units of its sd.
    baseline : parameter -> start value.
    terms : candidate terms.
    held : number of blocks, counted from the last, that are held out.
    scale : parameter -> typical size, which sets the step of finite differences; 1 where omitted.
    noise_known : the sd of ``measured`` is right; otherwise it is right up to a common factor.
    derive : parameters -> derived quantities.
    probe : name -> generic shapes, for each fitted block (n m, K).
    strata : for each fitted block (n m,) the noise stratum of a row.
    limits : parameter -> range of a fit.
    slopes : (parameters of all terms, names) -> for each block d f / d name (n m, K); by default central differences.
    """

    predict: Predict
    measured: tuple[ResidualBlock, ...]
    baseline: Mapping[str, float]
    terms: tuple[Term, ...]
    held: int = 0
    scale: Mapping[str, float] | None = None
    noise_known: bool = True
    derive: Callable[[Values], Values] | None = None
    probe: Mapping[str, tuple[FloatArray, ...]] | None = None
    strata: tuple[IntArray, ...] | None = None
    limits: Mapping[str, tuple[float, float]] | None = None
    slopes: Callable[[Values, Sequence[str]], Sequence[FloatArray]] | None = None

    @property
    def fitted(self) -> int:
        """Number of fitted blocks."""
        return len(self.measured) - self.held

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """argmin sum |r|^2 from the parameters of ``start`` and from the most promising scanned values.

        ``ok`` is false where least squares found no finite residual or did not converge.
        """
        # Importing scipy.optimize takes 0.2 s, which users of the types of this module need not spend.
        from scipy.optimize import least_squares

        chosen = [term for term in self.terms if term.name in terms]
        names = [*self.baseline, *(name for term in chosen for name in _all_names(term))]
        lower, upper = self._bounds(chosen, names)

        def rows(x: FloatArray) -> FloatArray:
            return self._rows(dict(zip(names, x.tolist())))

        def slopes(x: FloatArray) -> FloatArray:
            return -np.concatenate(self._columns(dict(zip(names, x.tolist())), names))

        best = None
        for first in self._starts(chosen, start):
            point = np.clip([first[name] for name in names], lower, upper)
            try:
                found = least_squares(
                    rows,
                    point,
                    jac=slopes,
                    bounds=(lower, upper),
                    x_scale="jac",
                    xtol=1e-10,
                    ftol=1e-10,
                    gtol=1e-10,
                )
            except (ValueError, np.linalg.LinAlgError):
                continue
            if np.isfinite(found.cost) and (best is None or found.cost < best.cost):
                best = found
        if best is None:
            return FitResult(False, terms, {}, (), (), "least squares found no finite residual from any start value")
        values = {name: float(x) for name, x in zip(names, best.x)}
        return self._result(terms, chosen, names, values, bool(best.status > 0))

    def signatures(self, fit: FitResult) -> Signatures:
        """Z (n m, K) by central differences at the null of every absent term, for every scanned value."""
        at = {name: value for name, (value, _) in fit.parameters.items()}
        blocks: list[list[FloatArray]] = [[] for _ in range(self.fitted)]
        candidates, column = [], 0
        for term in self.terms:
            if term.name in fit.terms:
                continue
            cells, grid = [], _grid(term)
            for found in self._term_columns(term, {**at, **{p.name: p.null for p in term.parameters}}):
                for block, z in zip(blocks, found):
                    block.append(z)
                cells.append(slice(column, column + len(term.parameters)))
                column += len(term.parameters)
            candidates.append(Candidate(term.name, term.parameters, tuple(cells), tuple(grid)))
        empty = [np.zeros((block.residual.size, 0)) for block in self.measured[: self.fitted]]
        return Signatures(tuple(candidates), tuple(np.concatenate([e, *z], axis=1) for e, z in zip(empty, blocks)))

    def probes(self, fit: FitResult) -> Signatures:
        """The generic shapes (n m, K) given as ``probe``."""
        shapes = self.probe or {}
        empty = [np.zeros((block.residual.size, 0)) for block in self.measured[: self.fitted]]
        candidates, column = [], 0
        for name, columns in shapes.items():
            k = columns[0].shape[1]
            parameters = tuple(TermParameter(f"{name}{i}") for i in range(k))
            candidates.append(Candidate(name, parameters, (slice(column, column + k),)))
            column += k
        blocks = (np.concatenate([e, *(z[b] for z in shapes.values())], axis=1) for b, e in enumerate(empty))
        return Signatures(tuple(candidates), tuple(blocks))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """One region per fitted block, with n m degrees of freedom."""
        return [Region("block", {"block": b.name}, b.chi2, float(b.residual.size)) for b in fit.blocks]

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Empty: the rows are not ordered by frequency."""
        return ()

    def _result(
        self, terms: tuple[str, ...], chosen: Sequence[Term], names: list[str], values: dict[str, float], ok: bool
    ) -> FitResult:
        jacobian = self._columns(values, names)
        gram = sum((jac.T @ jac for jac in jacobian), np.zeros((len(names), len(names))))
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        sd = np.sqrt(np.maximum(np.diag(np.linalg.pinv(gram / size / size[:, None], hermitian=True)), 0.0)) / size
        (predicted,) = self.predict([self._at_null(values)])
        blocks = tuple(replace(old, residual=old.residual - new) for old, new in zip(self.measured, predicted))
        rows = sum(block.residual.size for block in blocks[: self.fitted])
        chi2 = sum(block.chi2 for block in blocks[: self.fitted])
        if not self.noise_known:
            free = sum(block.nuisances for block in blocks[: self.fitted])
            sd = sd * np.sqrt(chi2 / max(rows - free - len(names), 1))
        columns = {term.name: tuple(names.index(name) for name in _all_names(term)) for term in chosen}
        nulls = {p.name: p.null for term in chosen if term.has_slope for p in term.parameters}
        shifts = {
            term.name: tuple(values[name] - nulls.get(name, values[name]) for name in _all_names(term))
            for term in chosen
        }
        level = np.sqrt(sum(float(np.vdot(b.residual, b.residual)) for b in self.measured[: self.fitted]))
        return FitResult(
            ok,
            terms,
            {name: (values[name], float(s)) for name, s in zip(names, sd)},
            blocks[: self.fitted],
            tuple(jacobian),
            "" if ok else "least squares did not converge",
            {name: (value, float("nan")) for name, value in (self.derive(values) if self.derive else {}).items()},
            blocks[self.fitted :],
            columns,
            shifts,
            self.strata,
            self.noise_known,
            nuisances=sum(block.nuisances for block in blocks[: self.fitted]),
            relative_error={"fit": float(np.sqrt(chi2) / max(level, 1e-300))},
        )

    def _at_null(self, values: Values) -> dict[str, float]:
        """Parameters of all terms: absent terms at their null, scanned parameters at their first value."""
        full = {name: values[0] for term in self.terms for name, values in (term.scanned or {}).items()}
        full.update({p.name: p.null for term in self.terms for p in term.parameters})
        return {**full, **values}

    def _rows(self, values: Values) -> FloatArray:
        (predicted,) = self.predict([self._at_null(values)])
        pairs = zip(self.measured[: self.fitted], predicted)
        return np.concatenate([(block.residual - new).reshape(-1) for block, new in pairs])

    def _columns(self, values: Values, names: Sequence[str]) -> list[FloatArray]:
        """d f / d parameter for each fitted block (n m, len(names))."""
        at = self._at_null(values)
        if self.slopes is not None:
            return list(self.slopes(at, names))[: self.fitted]
        columns: list[list[FloatArray]] = [[] for _ in range(self.fitted)]
        steps = [1e-5 * max(abs(at[name]), (self.scale or {}).get(name, 1.0)) for name in names]
        moved = [{**at, name: at[name] + side * step} for name, step in zip(names, steps) for side in (1.0, -1.0)]
        found = self.predict(moved) if moved else []
        for step, above, below in zip(steps, found[::2], found[1::2]):
            for block, up, down in zip(columns, above, below):
                block.append(((up - down) / (2.0 * step)).reshape(-1))
        return [
            np.stack(block, axis=1) if block else np.zeros((old.residual.size, 0))
            for block, old in zip(columns, self.measured)
        ]

    def _term_columns(self, term: Term, at: Values) -> list[list[FloatArray]]:
        """For each point of the grid of a term, and each fitted block, the columns (n m, K) of its parameters at ``at``."""
        points = [{**at, **scanned} for scanned in _grid(term)]
        if term.has_slope:
            return [self._columns(point, [p.name for p in term.parameters]) for point in points]
        plain, *moved = self.predict([self._at_null(point) for point in (at, *points)])
        return [[(b - a).reshape(-1, 1) for a, b in zip(plain[: self.fitted], one)] for one in moved]

    def _bounds(self, chosen: Sequence[Term], names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        sides = {p.name: (p.side, p.null) for term in chosen for p in term.parameters}
        scanned = [pair for term in chosen for pair in (term.scanned or {}).items()]
        free = sides.keys() | {name for term in chosen for name in term.fitted}
        scans = {name: values for name, values in scanned if len(values) > 1 and name not in free}
        limits = self.limits or {}
        lower = [sides[n][1] if n in sides and sides[n][0] > 0 else min(scans.get(n, (-np.inf,))) for n in names]
        upper = [sides[n][1] if n in sides and sides[n][0] < 0 else max(scans.get(n, (np.inf,))) for n in names]
        lower = [max(low, limits.get(n, (low, np.inf))[0]) for n, low in zip(names, lower)]
        upper = [min(high, limits.get(n, (-np.inf, high))[1]) for n, high in zip(names, upper)]
        return np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)

    def _starts(self, chosen: Sequence[Term], start: FitResult | None) -> list[dict[str, float]]:
        known = {name: value for name, (value, _) in start.parameters.items()} if start is not None else {}
        points = [{**self._at_null(self.baseline), **known}]
        for term in chosen:
            if term.scanned and not (start is not None and term.name in start.terms):
                points = [first for point in points for first in self._promising(term, point)]
        return points

    def _promising(self, term: Term, point: dict[str, float]) -> list[dict[str, float]]:
        """The scanned values that leave the smallest residual after one Gauss-Newton step, with the sizes of that step."""
        names = [p.name for p in term.parameters]
        rows = self._rows(point)
        shared = np.concatenate(self._columns(point, list(self.baseline)))
        trials = []
        for scanned, blocks in zip(_grid(term), self._term_columns(term, point)):
            columns = np.concatenate(blocks)
            # A change from the null to a value is neither more nor less than that.
            both = np.concatenate([shared, columns], axis=1) if term.has_slope else shared
            goal = rows if term.has_slope else rows - columns[:, 0]
            step, *_ = np.linalg.lstsq(both / np.linalg.norm(both, axis=0), goal, rcond=1e-12)
            left = goal - both / np.linalg.norm(both, axis=0) @ step
            size = step[shared.shape[1] :] / np.linalg.norm(columns, axis=0)[: both.shape[1] - shared.shape[1]]
            trials.append((float(np.vdot(left, left)), {**point, **dict(zip(names, size.tolist())), **scanned}))
        return [first for _, first in sorted(trials, key=lambda pair: pair[0])[:STARTS]]


def _all_names(term: Term) -> list[str]:
    return [
        *(p.name for p in term.parameters if p.name not in (term.scanned or {})),
        *(name for name, values in (term.scanned or {}).items() if len(values) > 1 or name in term.fitted),
    ]


def _grid(term: Term) -> list[dict[str, float]]:
    points: list[dict[str, float]] = [{}]
    for name, values in (term.scanned or {}).items():
        points = [{**point, name: value} for point in points for value in values]
    return points
