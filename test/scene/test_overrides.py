"""Overrides are applied before validation, validated alike, and named in errors."""

from __future__ import annotations

import numpy as np
import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.scene.model import Channel, Solver
from rb_dynamics.scene.read import parse_scene

TEXT = """\
body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}
wrenches: [{topic: a}, {topic: b}]
solver: {method: rk4, step: 0.01}
"""


def test_scalars_are_replaced() -> None:
    overrides = {"body.mass": 17, "duration": 10.0, "world_frame": "map", "wrenches[1].timeout": 0.5}
    scene = parse_scene(TEXT, overrides=overrides)
    assert scene.body.mass == 17.0
    assert scene.duration == 10.0
    assert scene.frames.world_frame == "map"
    assert scene.channels == (Channel("a"), Channel("b", 0.5))


def test_the_text_of_a_scene_makes_the_same_scene() -> None:
    overrides = {
        "solver.accuracy": 1e-6,
        "duration": 1 / 3,
        "world_frame": "1e-9",
        "body.frame": "on",
        "body.frames.été": {"position": np.array([0.1, -0.0, 1e-300])},
        "wrenches[1].optional": True,
    }
    scene = parse_scene(TEXT, "s.yaml", overrides)
    assert scene.frames.world_frame == "1e-9"
    assert scene.duration == 1 / 3
    assert scene.text.startswith("# s.yaml with overrides of solver.accuracy, duration, world_frame, ")
    assert parse_scene(scene.text, "s.yaml") == scene


def test_sections_are_made() -> None:
    scene = parse_scene(
        TEXT, overrides={"initial.angular_velocity_body": [1, 2, 3], "body.frames.tool.position": (1, 0, 0)}
    )
    assert scene.initial.angular_velocity_body == (1.0, 2.0, 3.0)
    assert scene.frames.fixed is not None
    assert scene.frames.fixed["tool"].position == (1.0, 0.0, 0.0)


def test_items_of_lists_are_replaced() -> None:
    assert parse_scene(TEXT, overrides={"body.inertia.diagonal[0]": 1.5}).body.principal_moments == (1.5, 2.0, 3.0)


def test_an_item_with_a_name_is_found_by_it() -> None:
    text = (
        TEXT + "sensors: [{type: pose, name: cam, rate: 5}, {type: imu, name: imu, rate: 10, gyro: {bias: [1, 2, 3]}}]"
    )
    scene = parse_scene(text, overrides={"sensors.imu.rate": 50, "sensors.imu.gyro.bias[1]": 0, "sensors[0].delay": 1})
    assert [(each.rate, each.delay) for each in scene.sensors] == [(5.0, 1.0), (50.0, 0.0)]
    assert "[1, 0, 3]" in scene.text
    with pytest.raises(
        SceneError, match=r"sensors.gyro.rate: found no sensor gyro, expected one of cam, imu; correct the override"
    ):
        parse_scene(text, overrides={"sensors.gyro.rate": 50})


def test_numpy_values() -> None:
    overrides = {
        "body.mass": np.float64(3.0),
        "duration": np.int64(4),
        "wrenches[0].optional": np.bool_(True),
        "initial.position_world": np.array([1.0, 2.0, 3.0]),
    }
    scene = parse_scene(TEXT, overrides=overrides)
    assert (scene.body.mass, scene.duration, scene.channels[0].optional) == (3.0, 4.0, True)
    assert scene.initial.position_world == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("solver", "overrides", "expected"),
    [
        ("{step: 0.01}", {"solver.accuracy": 1e-6}, Solver("auto", None, 1e-6)),
        ("{accuracy: 0.01}", {"solver.step": 0.1}, Solver("auto", 0.1, None)),
        ("{step: 0.01}", {"solver.step": 0.1}, Solver("auto", 0.1, None)),
        ("{step: 0.01}", {"solver.method": "rkmk4"}, Solver("rkmk4", 0.01, None)),
        ("{}", {"solver.step": 0.1, "solver.method": "rk4"}, Solver("rk4", 0.1, None)),
    ],
)
def test_step_and_accuracy_replace_each_other(solver: str, overrides: dict[str, object], expected: Solver) -> None:
    text = f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 3]}}}}\nsolver: {solver}"
    assert parse_scene(text, overrides=overrides).solver == expected


def test_the_linear_velocity_in_other_axes_replaces_that_of_the_file() -> None:
    text = "body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\ninitial: {linear_velocity_body: [1, 2, 3]}\n"
    scene = parse_scene(text, overrides={"initial.linear_velocity_world": [4.0, 5.0, 6.0]})
    assert scene.initial.linear_velocity_world == (4.0, 5.0, 6.0)


@pytest.mark.parametrize(
    ("overrides", "fragment"),
    [
        ({"body.mass": -1.0}, "s.yaml:override: body.mass: found -1.0, expected a number greater than 0 (kg)"),
        ({"body.mass": True}, "s.yaml:override: body.mass: found true, expected a number"),
        (
            {"body.mass": "17"},
            "s.yaml:override: body.mass: found '17', expected a number greater than 0 (kg); remove the q",
        ),
        ({"body.mass": float("nan")}, "s.yaml:override: body.mass: found nan"),
        ({"body.mass": 10**400}, "s.yaml:override: body.mass: found 1000"),
        ({"body.mass": None}, "s.yaml:override: body.mass: found nothing"),
        ({"body.mass": b"17"}, "s.yaml:override: body.mass: found b'17'"),
        ({"body.mass": {"kg": 1}}, "s.yaml:override: body.mass: found {kg: 1}"),
        ({"body.mas": 1.0}, "s.yaml:override: body.mas: found an unknown key, expected one of"),
        ({"body.inertia.diagonal": [1, 1, 3]}, "s.yaml:override: body.inertia.diagonal: found [1, 1, 3], expected"),
        ({"solver.method": "rk9"}, "s.yaml:override: solver.method: found 'rk9', expected one of auto"),
        ({"solver.step": 0.1, "solver.accuracy": 0.1}, "solver: found both step and accuracy"),
        (
            {"wrenches[2].topic": "c"},
            "s.yaml:override: wrenches[2].topic: found wrenches to be [{topic: a}, {topic: b}]",
        ),
        ({"body.mass.kg": 1}, "s.yaml:override: body.mass.kg: found body.mass to be 2, expected it to hold the key kg"),
        (
            {"wrenches.1.topic": "c"},
            "[{topic: a}, {topic: b}], expected it to hold the key 1; did you mean wrenches[1]?",
        ),
        ({"wrenches.2.topic": "c"}, "expected it to hold the key 2; correct the override"),
        ({"wrenches.topic": "c"}, "s.yaml:override: wrenches.topic: found wrenches to be"),
        ({"body[0]": 1}, "s.yaml:override: body[0]: found body to be {mass: 2"),
        ({"": 1}, "s.yaml:override: found this as an override, expected a dotted key"),
        ({"body..mass": 1}, "s.yaml:override: body..mass: found this as an override, expected a dotted key"),
        ({"wrenches[-1].topic": 1}, "s.yaml:override: wrenches[-1].topic: found this as an override"),
    ],
)
def test_wrong_overrides_are_named(overrides: dict[str, object], fragment: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(TEXT, "s.yaml", overrides)
    assert fragment in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_override_mends_a_wrong_file() -> None:
    assert parse_scene(TEXT.replace("mass: 2", "mass: -2"), overrides={"body.mass": 2}).body.mass == 2.0


def test_the_two_uses_of_an_alias_are_overridden_apart() -> None:
    text = "body: {mass: 2, inertia: {diagonal: &v [1, 2, 3]}}\ninitial: {position_world: *v}"
    scene = parse_scene(text, overrides={"initial.position_world[0]": 9})
    assert scene.initial.position_world == (9.0, 2.0, 3.0)
    assert scene.body.principal_moments == (1.0, 2.0, 3.0)
