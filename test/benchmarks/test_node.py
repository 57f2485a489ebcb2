"""The benchmark of the node: which messages count as late, and how many of them are due to the machine."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

MS = 1_000_000


@pytest.fixture(scope="module")
def node(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("node")


def test_late_is_more_than_a_period(node: ModuleType) -> None:
    delays = [(k * MS, 0) for k in range(1000)]
    delays[10], delays[20], delays[30] = (10 * MS, MS), (20 * MS, MS + 1), (30 * MS, 5 * MS)
    text = node.punctuality(delays, MS, [])
    assert text.startswith("2 of 1000 ticks late (0.200 %), behind p50 0.00 p99 0.00 max 5.0 ms")


def test_a_stall_counts_until_as_long_again_after_it_and_overlaps_once(node: ModuleType) -> None:
    delays = [(k * MS, 2 * MS if k in (13, 14, 500) else 0) for k in range(1001)]
    # From 9 to 11.5 ms and seen by both processors: with as long again, until 14 ms.
    stalls = [(9 * MS, 11 * MS + MS // 2), (10 * MS, 11 * MS + MS // 2)]
    text = node.punctuality(delays, MS, stalls)
    assert "3 of 1001 ticks late (0.300 %; 2 of them in stalls of the machine and after, which are 0.5 % of" in text
