"""A text column with few different values as numbers, so that a million devices are counted and compared as arrays.

    text[i] = words[codes[i]]

Shapes: B values, W different words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
import numpy.typing as npt

from pipeline.arrays import BoolArray

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CodedText(Sequence[str]):
    """B texts as ``codes`` (B,) into the W different ``words``; a sequence of texts for all who read it as such."""

    words: tuple[str, ...]
    codes: IntArray

    def __len__(self) -> int:
        return int(self.codes.size)

    @overload
    def __getitem__(self, place: int) -> str: ...

    @overload
    def __getitem__(self, place: slice) -> CodedText: ...

    def __getitem__(self, place: int | slice) -> str | CodedText:
        if isinstance(place, slice):
            return CodedText(self.words, self.codes[place])
        return self.words[int(self.codes[place])]

    def __iter__(self) -> Iterator[str]:
        return (self.words[code] for code in self.codes.tolist())

    def at(self, rows: BoolArray | IntArray) -> CodedText:
        """The texts of ``rows``: numbers, or (B,) whether a row is wanted."""
        return CodedText(self.words, self.codes[rows])

    def equals(self, word: str) -> BoolArray:
        """(B,) whether the text is ``word``."""
        return self.each([one == word for one in self.words])

    def each(self, known: Sequence[bool]) -> BoolArray:
        """(B,) what is known of the word (W,) of each text."""
        return np.asarray(np.array([*known, False], dtype=np.bool_)[self.codes])

    def counts(self) -> dict[str, int]:
        """How often each word occurs, in the order of its first occurrence; words that do not occur are left out."""
        number = np.bincount(self.codes, minlength=len(self.words))
        first = np.zeros(len(self.words), dtype=np.int64)
        first[self.codes[::-1]] = np.arange(len(self))[::-1]  # of equal codes the last assignment stays
        present = np.flatnonzero(number)
        return {self.words[code]: int(number[code]) for code in present[np.argsort(first[present])].tolist()}

    def filled(self, other: CodedText) -> CodedText:
        """The texts, and those of ``other`` (B,) where they are empty."""
        words = tuple(dict.fromkeys((*self.words, *other.words)))
        place = {word: k for k, word in enumerate(words)}
        own, theirs = (np.array([place[w] for w in text.words], dtype=np.int64) for text in (self, other))
        empty = self.equals("")
        codes = np.zeros(len(self), dtype=np.int64)
        codes[empty], codes[~empty] = theirs[other.codes[empty]], own[self.codes[~empty]]
        return CodedText(words, codes)


def coded(texts: Sequence[str]) -> CodedText:
    """``texts`` as numbers; the words are in the order of their first occurrence."""
    if isinstance(texts, CodedText):
        return texts
    place: dict[str, int] = {}
    codes = np.fromiter((place.setdefault(text, len(place)) for text in texts), dtype=np.int64, count=len(texts))
    return CodedText(tuple(place), codes)


def numbered(codes: IntArray) -> tuple[IntArray, IntArray]:
    """The different numbers that occur, ascending, and the place (B,) of each number in them; ``codes`` (B,) are not negative.

    ``np.unique`` with its inverse, without a sort where the numbers are not much larger than B.
    """
    if not codes.size or int(codes.max()) > 8 * codes.size:
        present, index = np.unique(codes, return_inverse=True)
        return present, index.astype(np.int64)
    occurs = np.bincount(codes) > 0
    return np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[codes]


def paired(first: CodedText, second: CodedText) -> tuple[tuple[tuple[str, str], ...], IntArray]:
    """The pairs of words that occur together, in order of their codes, and the number (B,) of the pair of each row."""
    key = first.codes * max(len(second.words), 1) + second.codes
    present, index = numbered(key)
    pairs = tuple((first.words[k // len(second.words)], second.words[k % len(second.words)]) for k in present.tolist())
    return pairs, index
