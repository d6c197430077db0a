"""Whether a compiled loop is in the cache on disk."""

from __future__ import annotations

from contextlib import suppress
from typing import Any


def is_cached(loop: Any, types: Any) -> bool:
    """Whether the cache of numba holds ``loop`` compiled from its present source, for the types of its arguments.

    ``types`` : as they were given to the compiler: a tuple of types, or the signature that the decorator had.
    """
    # numba has no public question for it: the date of a file in the cache says nothing, as the cache compares contents.
    with suppress(AttributeError):
        cache = loop._cache
        return cache._index_key(types, loop.targetctx.codegen()) in cache._cache_file._load_index()
    return False
