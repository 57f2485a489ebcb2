"""Small caches of recent results about a body and its motion; `clear_caches` empties all of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from functools import _lru_cache_wrapper

_T = TypeVar("_T")

_forget: list[Callable[[], None]] = []


def cached_results(count: int) -> Callable[[Callable[..., _T]], _lru_cache_wrapper[_T]]:
    """Return a decorator that caches the last `count` results of a function."""

    def decorate(function: Callable[..., _T]) -> _lru_cache_wrapper[_T]:
        memory = lru_cache(maxsize=count)(function)
        _forget.append(memory.cache_clear)
        return memory

    return decorate


def clear_caches() -> None:
    """Empty all caches, so that the next run computes everything itself, as a fair measurement of time needs."""
    for clear in _forget:
        clear()
