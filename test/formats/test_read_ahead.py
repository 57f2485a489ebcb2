"""`one_ahead`: order, errors in their turn, one item at most in hand, and no thread left."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from rb_dynamics.formats.read_ahead import one_ahead


def test_items_come_in_order_from_another_thread() -> None:
    threads = set()

    def items() -> Iterator[int]:
        for k in range(100):
            threads.add(threading.get_ident())
            yield k

    assert [*one_ahead(items())] == [*range(100)]
    assert len(threads) == 1
    assert threading.get_ident() not in threads


def test_only_one_item_is_computed_ahead() -> None:
    computed: list[int] = []
    third = threading.Event()

    def items() -> Iterator[int]:
        for k in range(5):
            computed.append(k)
            if k == 2:
                third.set()
            yield k

    ahead = one_ahead(items())
    assert next(ahead) == 0
    assert next(ahead) == 1
    assert third.wait(10.0)
    assert computed == [0, 1, 2]
    assert [*ahead] == [2, 3, 4]


def test_an_error_comes_after_the_items_before_it() -> None:
    def items() -> Iterator[int]:
        yield 1
        yield 2
        raise ValueError("the third")

    seen: list[int] = []
    with pytest.raises(ValueError, match="the third"):
        seen.extend(one_ahead(items()))
    assert seen == [1, 2]


@pytest.mark.parametrize("taken", [0, 1, 3])
def test_no_thread_is_left_by_one_that_stops_early(taken: int) -> None:
    before = threading.enumerate()
    ahead = one_ahead(iter(range(1000)))
    assert [next(ahead) for _ in range(taken)] == [*range(taken)]
    ahead.close()
    assert threading.enumerate() == before
