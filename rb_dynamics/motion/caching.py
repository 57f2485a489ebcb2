"""Small caches of recent results about a body and its motion, all of which `clear_caches` can empty."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from functools import _lru_cache_wrapper

_T = TypeVar("_T")

_forget: list[Callable[[], None]] = []


def cached_results(count: int) -> Callable[[Callable[..., _T]], _lru_cache_wrapper[_T]]:
    """Let a function remember its last `count` results."""

    def decorate(function: Callable[..., _T]) -> _lru_cache_wrapper[_T]:
        memory = lru_cache(maxsize=count)(function)
        _forget.append(memory.cache_clear)
        return memory

    return decorate


def clear_caches() -> None:
    """Empty all memories, so that what is timed next finds nothing that was computed before."""
    for clear in _forget:
        clear()
