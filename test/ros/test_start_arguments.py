"""Arguments of launch files are read like scene files, not by the rules of YAML 1.1."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rb_dynamics.ros.start_arguments import side_by_side, spacing_of, value_of, values_of


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", {}),
        ("{}", {}),
        ("{solver.step: 1e-3}", {"solver.step": 0.001}),
        ("{body.mass: 17}", {"body.mass": 17}),
        ("{body.mass: 010, duration: 1_000, a: 12:30:45, b: 0x10, c: '5'}",
         {"body.mass": "010", "duration": "1_000", "a": "12:30:45", "b": "0x10", "c": "5"}),
        ("{a: [0, 1.5, {b: true}], c: on, d: null}", {"a": [0, 1.5, {"b": True}], "c": True, "d": None}),
    ],
)  # fmt: skip
def test_values_are_those_of_a_scene_file(text: str, expected: dict[str, object]) -> None:
    found = values_of("overrides", text)

    assert found == expected
    assert repr(found) == repr(expected)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("5", "'5'"),
        ("[1]", "[1]"),
        ("{a: 1", "{a: 1"),
        ("{a: 1, a: 2}", "found again"),
        ("{a: &x [1], b: !!python/object:os.system 1}", "tag"),
        ("a: " + "[" * 20_000, "nested"),
    ],
)
def test_what_means_no_values_is_named(text: str, named: str) -> None:
    with pytest.raises(ValueError, match=r"argument overrides: found .*expected values by name") as caught:
        values_of("overrides", text)

    assert named in str(caught.value)
    assert len(str(caught.value)) < 500


def test_spacing_is_along_y_or_in_any_direction() -> None:
    assert spacing_of("-2") == (0.0, -2.0, 0.0)
    assert spacing_of("[1, 0, 0.5]") == (1.0, 0.0, 0.5)
    for text in ("", "[1, 2]", "inf", "[1, 2, x]"):
        with pytest.raises(ValueError, match="argument spacing: found"):
            spacing_of(text)


def test_bodies_stand_beside_the_place_that_is_given(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {}\ninitial: {position_world: [7, 8, 9]}\n")
    given: dict[str, object] = {"body.mass": 2.0, "pose_covariance": [1.0] * 6}
    assert side_by_side(str(scene), given, 2, "b", (1.0, 0.0, 0.5)) == {
        "b1": {"initial.position_world": [7.0, 8.0, 9.0]},
        "b2": {"initial.position_world": [8.0, 8.0, 9.5]},
    }
    given["initial.position_world"] = [1, 2, 3]
    assert list(side_by_side(str(scene), given, 1, "b", (1.0, 0.0, 0.5)).values()) == [
        {"initial.position_world": [1.0, 2.0, 3.0]}
    ]


def test_a_number_is_a_plain_decimal() -> None:
    assert value_of("spacing", "1e-3", float) == 0.001
    assert math.isinf(value_of("spacing", "inf", float))  # type: ignore[arg-type]
    assert value_of("lockstep", "True", bool) is True
    for text, kind in (("1_0", int), ("1_0.5", float), ("0x10", int), ("1.0", int), ("yes", bool)):
        with pytest.raises(ValueError, match=f"argument count: found '{text}', expected"):
            value_of("count", text, kind)
