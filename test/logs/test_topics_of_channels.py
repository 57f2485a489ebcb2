"""Which recorded topic is which channel of a scene."""

from __future__ import annotations

import pytest

from rb_dynamics.logs.topics_of_channels import names_in_scene


@pytest.mark.parametrize(
    ("topics", "names", "expected"),
    [
        (["/wrench", "/a/wrench"], ["wrench"], {"/wrench": "wrench"}),
        (["/a/wrench"], ["wrench"], {"/a/wrench": "wrench"}),
        (
            ["/a/b/wrench", "/a/w/command"],
            ["wrench", "w/command"],
            {"/a/b/wrench": "wrench", "/a/w/command": "w/command"},
        ),
        (["/a/wrench", "/b/wrench"], ["wrench"], {}),
        (["/a/jet/wrench"], ["wrench", "jet/wrench"], {}),
        (["/a_wrench", "/a/wrench/applied", "/a/effects/wrench"], ["wrench"], {}),
        (["/a/wrench"], ["/wrench"], {}),
        (["wrench"], ["/wrench"], {"wrench": "/wrench"}),
        (["/jet/wrench", "/a/wrench"], ["wrench", "jet/wrench"], {"/jet/wrench": "jet/wrench", "/a/wrench": "wrench"}),
    ],
)
def test_exact_names_count_first_then_what_fits_both_ways(
    topics: list[str], names: list[str], expected: dict[str, str]
) -> None:
    assert names_in_scene(topics, names) == expected


def test_what_is_chosen_counts_before_the_name() -> None:
    topics, names = ["/wrench", "/a/wrench", "/b/push"], ["wrench", "push"]
    assert names_in_scene(topics, names, {"a/wrench": "/wrench"}) == {"/a/wrench": "wrench", "/b/push": "push"}
