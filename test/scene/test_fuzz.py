"""Any scene file, text or override gives either a valid scene or a `SceneError`."""

from __future__ import annotations

import contextlib
import copy
import math
from pathlib import Path
from typing import Any

import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rb_dynamics.errors import SceneError
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import parse_scene, read_scene

SLEW = (Path(__file__).parents[2] / "config" / "slew.yaml").read_text(encoding="utf-8")
FULL: dict[str, Any] = yaml.safe_load(SLEW)
FULL["body"]["frames"] = {"tool": {"position": [1, 2, 3], "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}
DUMPED = yaml.safe_dump(FULL)

FEW = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])

numbers = st.one_of(
    st.floats(), st.integers(), st.integers(-(10**400), 10**400), st.sampled_from([0, -1, 1e308, 5e-324, 1e-9, 9.3e9])
)
scalars = st.one_of(numbers, st.booleans(), st.none(), st.text(max_size=8), st.dates(), st.binary(max_size=4))
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.sampled_from(["x", "y", "z", "w", "topic", "type", "moments", "diagonal", "<<"]), inner),
        st.lists(st.lists(numbers, min_size=3, max_size=3), min_size=3, max_size=3),
    ),
    max_leaves=9,
)


def check(text: str, overrides: dict[str, object] | None = None) -> None:
    try:
        scene = parse_scene(text, "s.yaml", overrides or {})
    except SceneError as error:
        lines = str(error).splitlines()
        assert 1 <= len(lines) <= 21
        assert all(line.startswith("s.yaml:") and line.isprintable() for line in lines)
        return
    check_sound(scene)
    assert parse_scene(scene.text, "s.yaml") == scene


def check_sound(scene: Scene) -> None:
    state = scene.initial
    assert scene.body.mass > 0.0
    if yaml.safe_load(scene.text)["body"].get("inertia") is None:
        assert scene.body.is_particle
    else:
        assert all(m > 0.0 and math.isfinite(m) for m in scene.body.principal_moments)
    assert math.isclose(math.hypot(*state.orientation_xyzw), 1.0, rel_tol=1e-15)
    vectors = (
        state.position_world,
        state.linear_velocity_world,
        state.angular_velocity_body,
        scene.body.center_of_mass,
    )
    assert all(math.isfinite(component) for vector in vectors for component in vector)
    assert (scene.solver.step is None) != (scene.solver.accuracy is None)
    assert len({channel.topic.strip("/") for channel in scene.channels}) == len(scene.channels)
    for seconds in (scene.duration, scene.solver.step, *(channel.timeout or None for channel in scene.channels)):
        assert seconds is None or 0 < round(seconds * 1e9) < 2**63


def places(value: Any) -> list[tuple[Any, Any]]:
    """Return every (container, key) in `value`."""
    found = []
    if isinstance(value, (dict, list)):
        for key in value if isinstance(value, dict) else range(len(value)):
            found += [(value, key), *places(value[key])]
    return found


def test_a_scene_without_all_that_may_be_left_out_is_that_of_a_particle() -> None:
    scene = copy.deepcopy(FULL)
    del scene["body"]["inertia"], scene["body"]["frames"], scene["initial"]
    check(yaml.safe_dump(scene))
    assert parse_scene(yaml.safe_dump(scene)).body.is_particle


@FEW
@given(data=st.data())
def test_a_scene_with_values_replaced_moved_or_removed(data: st.DataObject) -> None:
    scene = copy.deepcopy(FULL)
    for _ in range(data.draw(st.integers(1, 3))):
        spots = places(scene)
        if not spots:
            break
        container, key = data.draw(st.sampled_from(spots))
        match data.draw(st.sampled_from(["replace", "remove", "rename", "copy"])):
            case "replace":
                container[key] = data.draw(values)
            case "remove":
                del container[key]
            case "rename" if isinstance(container, dict):
                container[data.draw(st.text(max_size=5))] = container.pop(key)
            case _:
                container[key] = copy.deepcopy(data.draw(st.sampled_from([c[k] for c, k in spots])))
    check(yaml.safe_dump(scene))


@FEW
@given(
    source=st.sampled_from([SLEW, DUMPED]),
    at=st.integers(0, 3000),
    length=st.integers(0, 30),
    insert=st.one_of(
        st.text(max_size=12),
        st.text("{}[]:,-?&*!|>'\"%@`#~<=\\ \t\n\r0123456789eE.+xUu", max_size=12),
    ),
)
def test_a_scene_with_characters_replaced(source: str, at: int, length: int, insert: str) -> None:
    check(source[:at] + insert + source[at + length :])


@FEW
@given(text=st.one_of(st.text(), st.text("{}[]:,-?&*!|>'\"%@`#~<=\\ \n\tab0x1eU")))
def test_any_text(text: str) -> None:
    check(text)


@FEW
@given(numbers=st.lists(numbers, min_size=9, max_size=9), symmetric=st.booleans())
def test_any_inertia(numbers: list[float], symmetric: bool) -> None:
    a, b, c, d, e, f, g, h, i = numbers
    rows = [[a, b, c], [b, e, f], [c, f, i]] if symmetric else [[a, b, c], [d, e, f], [g, h, i]]
    text = "body: {mass: 1, inertia: {matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}"
    check(text, {"body.inertia.matrix": rows})
    text = "body: {mass: 1, inertia: {principal: {moments: [1, 1, 1]}}}"
    q = dict(zip("xyzw", numbers, strict=False))
    check(text, {"body.inertia.principal.moments": [a, e, i], "body.inertia.principal.orientation": q})


@FEW
@given(
    overrides=st.dictionaries(
        st.one_of(
            st.text(max_size=10),
            st.text("abcdy.[]01", max_size=10),
            st.sampled_from(
                ["body", "body.mass", "solver.step", "solver.accuracy", "duration", "wrenches[1].topic", "initial"]
            ),
        ),
        values,
        max_size=4,
    )
)
def test_any_override(overrides: dict[str, object]) -> None:
    check(SLEW, overrides)


@settings(FEW, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary())
def test_any_file(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(content)
    with contextlib.suppress(SceneError):
        check_sound(read_scene(path))
