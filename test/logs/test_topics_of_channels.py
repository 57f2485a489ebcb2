"""Which recorded topic is which channel of a scene."""

from __future__ import annotations

import pytest

from rb_dynamics.logs.topics_of_channels import names_in_scene, of_one_body


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


@pytest.mark.parametrize(
    ("topics", "names", "motion", "others", "kept", "certain"),
    [
        (["/a/wrench", "/b/wrench"], ["wrench"], "/b/pose", ["/a/pose"], ["/b/wrench"], True),
        (["/a/wrench", "/b/wrench"], [], "/b/truth/pose", [], ["/b/wrench"], True),
        (["/a/wrench", "/b/wrench"], ["wrench"], "/pose", [], ["/a/wrench", "/b/wrench"], False),
        (["/a/wrench", "/b/wrench"], ["wrench"], "", [], ["/a/wrench", "/b/wrench"], False),
        (["/a/wrench", "/b/wrench"], ["a/wrench", "b/wrench"], "/pose", [], ["/a/wrench", "/b/wrench"], True),
        (["/wrench", "/b/wrench"], ["wrench"], "/pose", [], ["/wrench"], True),
        (["/a/wrench", "/a/push"], [], "/b/pose", [], ["/a/wrench", "/a/push"], True),
        (["/a/wrench"], ["wrench"], "/b/pose", ["/a/pose"], ["/a/wrench"], False),
        (["/a/wrench"], ["wrench"], "/b/pose", ["/a/truth"], ["/a/wrench"], False),
        (["/wrench", "/b/wrench"], ["wrench"], "/b/pose", [], ["/wrench"], False),
        (["/a_wrench", "/b_wrench"], ["wrench"], "/b_pose", ["/a_pose"], ["/b_wrench"], True),
        (["/a_wrench"], ["wrench"], "/b_pose", ["/a_pose"], ["/a_wrench"], False),
        (["/left_wrench", "/right_wrench"], [], "/b_pose", [], ["/left_wrench", "/right_wrench"], True),
        (["/a/w/applied", "/b/w/applied"], [], "/a/pose", [], ["/a/w/applied"], True),
        (["/a/wrench", "/a/b/wrench"], ["wrench"], "/a/pose", ["/a/b/pose"], ["/a/wrench"], True),
        (["/a/wrench", "/a/b/wrench"], ["wrench"], "/a/b/pose", ["/a/pose"], ["/a/b/wrench"], True),
        (["/a/wrench", "/a/b/wrench"], ["wrench"], "/a/pose", [], ["/a/wrench", "/a/b/wrench"], False),
    ],
)
def test_of_several_bodies_the_commands_beside_the_motion_are_its_own(
    topics: list[str], names: list[str], motion: str, others: list[str], kept: list[str], certain: bool
) -> None:
    found, doubt = of_one_body(topics, names, motion, others)
    assert (found, doubt == "") == (kept, certain)
