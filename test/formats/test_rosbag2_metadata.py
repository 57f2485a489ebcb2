"""QoS of publishers in bags, which is untrusted input."""

from __future__ import annotations

import pytest

from rb_dynamics.formats.mcap_records import McapChannel, Schema
from rb_dynamics.formats.rosbag2_metadata import offered_qos


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", []),
        ("- durability: 1\n  depth: 10\n", [{"durability": 1, "depth": 10}]),
        ("- durability: transient_local\n", [{"durability": "transient_local"}]),
        ("durability: 1", []),
        ("- [", []),
        ("[" * 20_000, []),
        ("[1," * 300_000, []),
        ("- &a [1]\n- *a\n", []),
        ("- !!python/name:os.system\n", []),
        ("- 2001-99-99\n", []),
    ],
    ids=lambda value: str(value)[:20],
)
def test_profiles_are_read_within_limits(text: str, found: list[object]) -> None:
    assert offered_qos(McapChannel("/pose", Schema(), "cdr", {"offered_qos_profiles": text})) == found
