"""`one_ahead`: let another thread compute the next item while one is in use."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from itertools import islice
from typing import TypeVar

_Item = TypeVar("_Item")


def one_ahead(items: Iterator[_Item]) -> Generator[_Item, None, None]:
    """Yield items, of which another thread computes the next one meanwhile; an error is raised in its turn.

    No thread is left when the generator ends or is closed.
    """
    from concurrent.futures import ThreadPoolExecutor

    def following() -> list[_Item]:
        return list(islice(items, 1))

    with ThreadPoolExecutor(1, "one_ahead") as thread:
        ahead = thread.submit(following)
        while item := ahead.result():
            ahead = thread.submit(following)
            yield from item
