"""A problem without gyros: one straight line through noisy blocks, and curves as candidate terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.criticism.problem import Candidate, FitResult, Region, ResidualBlock, Signatures, Spectrum, TermParameter

ROWS = 400
#: Scale of the abscissa in each block; the last block is held out.
SCALES = (1.0, 1.0, 0.6, 0.35, 0.8)
X = np.linspace(-1.0, 1.0, ROWS)
FREQUENCIES = np.arange(12.0, 40.0, 1.0)

CURVES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "square": lambda x: x**2,
    "cube": lambda x: x**3,
    "cube_like": lambda x: x**3 + 0.02 * x**5,
    "kink": lambda x: np.abs(x - 0.2),
    "bump": lambda x: np.exp(-40.0 * (x - 0.3) ** 2),
    # The sum of "left" and "right" is nearly "sum"; their difference is large.
    "sum": lambda x: np.sin(15.0 * x),
    "left": lambda x: 0.45 * np.sin(15.0 * x) + np.cos(28.0 * x),
    "right": lambda x: 0.5 * np.sin(15.0 * x) - np.cos(28.0 * x),
    "outside": lambda x: np.exp(-300.0 * (x + 0.31) ** 2) - np.exp(-300.0 * (x + 0.24) ** 2),
}


def line(x: FloatArray, frequency: float) -> FloatArray:
    return np.stack([np.cos(frequency * x), np.sin(frequency * x)], axis=1)


@cache
def columns_of(term: str) -> tuple[FloatArray, ...]:
    """Columns of a term by block; those of "line" are a grid of frequencies."""
    if term == "line":
        return tuple(np.concatenate([line(scale * X, f) for f in FREQUENCIES], axis=1) for scale in SCALES)
    return tuple(CURVES[term](scale * X)[:, None] for scale in SCALES)


@cache
def bumps() -> tuple[FloatArray, ...]:
    """Narrow bumps at 41 places, by fitted block."""
    return tuple(np.exp(-800.0 * (scale * X[:, None] - np.linspace(-1.0, 1.0, 41)) ** 2) for scale in SCALES[:-1])


@dataclass(frozen=True, eq=False)
class Lines:
    """One straight line through all blocks, plus terms; the library may lack the term that the data contain."""

    data: Sequence[FloatArray]
    library: tuple[str, ...] = ("square", "cube", "kink", "bump", "line")
    sided: tuple[str, ...] = ("kink",)
    #: Terms whose parameters do not exist at the null.
    levels: tuple[str, ...] = ()
    strata: tuple[IntArray, ...] | None = None
    noise_known: bool = True
    fails: tuple[str, ...] = ()

    def baseline(self) -> list[FloatArray]:
        return [np.stack([np.ones(ROWS), scale * X], axis=1) for scale in SCALES]

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        design, names, columns, shifts = self.baseline(), ["a", "b"], {}, {}
        for term in terms:
            new = columns_of(term)
            if term == "line":
                new = self._best_line(design, new)
            width = new[0].shape[1]
            columns[term] = tuple(range(len(names), len(names) + width))
            names += [f"{term}{i}" for i in range(width)]
            design = [np.concatenate([old, more], axis=1) for old, more in zip(design, new)]
        fitted = np.concatenate(design[:-1])
        size, *_ = np.linalg.lstsq(fitted, np.concatenate(self.data[:-1]), rcond=None)
        for term in terms:
            if term in self.sided and size[columns[term][0]] < 0.0:
                size[columns[term][0]] = 0.0
        shifts = {
            term: tuple(0.0 if term in self.levels else float(size[i]) for i in own) for term, own in columns.items()
        }
        sd = np.sqrt(np.diag(np.linalg.pinv(fitted.T @ fitted)))
        rest = [y - d @ size for y, d in zip(self.data, design)]
        blocks = tuple(
            ResidualBlock(f"b{i}", r[:, None], {"scale": str(scale)}, "twice" if i < 2 else None)
            for i, (r, scale) in enumerate(zip(rest, SCALES))
        )
        return FitResult(
            not set(terms) & set(self.fails),
            terms,
            {name: (float(value), float(s)) for name, value, s in zip(names, size, sd)},
            blocks[:-1],
            tuple(design[:-1]),
            held=blocks[-1:],
            columns=columns,
            shifts=shifts,
            strata=self.strata,
            noise_known=self.noise_known,
        )

    def _best_line(self, design: list[FloatArray], columns: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
        y, chi2s = np.concatenate(self.data[:-1]), []
        for i in range(FREQUENCIES.size):
            trial = np.concatenate(
                [np.concatenate([d, c[:, 2 * i : 2 * i + 2]], axis=1) for d, c in zip(design, columns)][:-1]
            )
            chi2s.append(float(np.sum((y - trial @ np.linalg.lstsq(trial, y, rcond=None)[0]) ** 2)))
        best = int(np.argmin(chi2s))
        return tuple(c[:, 2 * best : 2 * best + 2] for c in columns)

    def signatures(self, fit: FitResult) -> Signatures:
        candidates, blocks, start = [], [np.zeros((ROWS, 0))] * (len(SCALES) - 1), 0
        for term in self.library:
            if term in fit.terms:
                continue
            new = columns_of(term)
            width = 2 if term == "line" else 1
            cells = tuple(slice(start + i, start + i + width) for i in range(0, new[0].shape[1], width))
            grid = tuple({"frequency": float(f)} for f in FREQUENCIES) if term == "line" else ({},)
            side = 1 if term in self.sided else 0
            parameters = tuple(TermParameter(f"{term}{i}", side=side, reach=10.0) for i in range(width))
            candidates.append(Candidate(term, parameters, cells, grid))
            blocks = [np.concatenate([old, more], axis=1) for old, more in zip(blocks, new)]
            start += new[0].shape[1]
        return Signatures(tuple(candidates), tuple(blocks))

    def probes(self, fit: FitResult) -> Signatures:
        width = bumps()[0].shape[1]
        parameters = tuple(TermParameter(f"at{i}") for i in range(width))
        return Signatures((Candidate("bumps", parameters, (slice(0, width),)),), bumps())

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        return ()

    def regions(self, fit: FitResult) -> Sequence[Region]:
        parts = [(b, i) for b in range(len(fit.blocks)) for i in range(0, ROWS, 80)]
        squares = [block.rows**2 for block in fit.blocks]
        return [
            Region(
                "abscissa",
                {"block": b, "from": i},
                float(np.sum(squares[b][i : i + 80])),
                80.0,
            )
            for b, i in parts
        ]


@dataclass(frozen=True)
class Toy:
    """Makes problems with hidden terms, whose SNR is that left by the baseline on the fitted blocks, and noise."""

    def problem(
        self,
        seed: int,
        hidden: Mapping[str, float] | None = None,
        noise: Callable[[np.random.Generator, int, int], FloatArray] | None = None,
        frequency: float = 23.0,
        factors: Sequence[float] = (1.0,) * len(SCALES),
        **options: object,
    ) -> Lines:
        rng = np.random.default_rng([seed, 77])
        data = [1.0 + 2.0 * scale * X for scale in SCALES]
        base = np.concatenate([np.stack([np.ones(ROWS), scale * X], axis=1) for scale in SCALES[:-1]])
        for term, snr in (hidden or {}).items():
            shape = (
                [line(s * X, frequency)[:, 0] for s in SCALES]
                if term == "line"
                else [c[:, 0] for c in columns_of(term)]
            )
            shape = [factor * z for factor, z in zip(factors, shape)]
            whole = np.concatenate(shape[:-1])
            left = whole - base @ np.linalg.lstsq(base, whole, rcond=None)[0]
            data = [y + snr / np.linalg.norm(left) * z for y, z in zip(data, shape)]
        draw = noise or (lambda generator, block, count: generator.standard_normal(count))
        data = [y + draw(rng, b, ROWS) for b, y in enumerate(data)]
        return Lines(tuple(data), **options)  # type: ignore[arg-type]
