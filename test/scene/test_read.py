"""Valid scenes: defaults, every key, number formats, files."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.wrench import FixedFrame, WrenchFrames
from rb_dynamics.motion import METHODS
from rb_dynamics.scene.model import Channel, Solver
from rb_dynamics.scene.read import parse_scene, read_scene

SMALLEST = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}"
HALF = math.sqrt(0.5)


def test_defaults() -> None:
    scene = parse_scene(SMALLEST)
    assert scene.body.mass == 2.0
    assert isinstance(scene.body.mass, float)
    assert scene.frames == WrenchFrames("world", "body", {}).of(scene.body)
    assert scene.initial == State()
    assert scene.channels == (Channel("wrench", 0.0, False),)
    assert scene.solver == Solver("auto", None, 1e-9)
    assert scene.duration is None
    assert scene.output_rate == 100.0
    assert (scene.text, scene.source) == (SMALLEST, "<scene>")


def test_every_key() -> None:
    scene = parse_scene(
        """
        world_frame: inertial
        body:
          frame: base_link
          mass: 16.8
          center_of_mass: [0.1, -0.2, 3]
          inertia: {matrix: [[0.2975, 0.0021, -0.0008], [0.0021, 0.2930, 0.0013], [-0.0008, 0.0013, 0.3104]]}
          frames:
            thruster: {position: [1, 2, 3], orientation: {x: 1, y: 0, z: 0, w: 0}}
            sensor: {}
        initial:
          position_world: [1, 2, 3]
          orientation: {w: 0, x: 0, y: 1, z: 0}
          linear_velocity_world: [4, 5, 6]
          angular_velocity_body: [7, 8, 9]
        wrenches:
          - {topic: wrench, timeout: 0.5}
          - {topic: /arm/wrench, optional: true, max_force: 10, max_torque: 1.5, on_excess: clip}
        effects: []
        solver: {method: rk4, step: 0.001}
        duration: 60
        output_rate: 0
        """
    )
    assert scene.body.inertia == ((0.2975, 0.0021, -0.0008), (0.0021, 0.2930, 0.0013), (-0.0008, 0.0013, 0.3104))
    assert scene.body.center_of_mass == (0.1, -0.2, 3.0)
    fixed = {"thruster": FixedFrame((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)), "sensor": FixedFrame()}
    assert scene.frames == WrenchFrames("inertial", "base_link", fixed, (0.1, -0.2, 3.0), turns=True)
    assert scene.initial == State(0, (1.0, 2.0, 3.0), (0.0, 1.0, 0.0, 0.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0))
    assert scene.channels == (Channel("wrench", 0.5, False), Channel("/arm/wrench", 0.0, True, 10.0, 1.5, "clip"))
    assert scene.solver == Solver("rk4", 0.001, None)
    assert (scene.duration, scene.output_rate) == (60.0, 0.0)


def test_principal_inertia_is_turned_into_body_axes() -> None:
    # A quarter turn about z carries the first principal axis to y.
    principal = f"{{moments: [1, 2, 3], orientation: {{x: 0, y: 0, z: {HALF!r}, w: {HALF!r}}}}}"
    body = parse_scene(f"body: {{mass: 1, inertia: {{principal: {principal}}}}}").body
    assert [body.inertia[i][i] for i in range(3)] == pytest.approx([2.0, 1.0, 3.0], abs=1e-15)
    assert body.principal_moments == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("text", ["9007199254740993", "9007199254740991.5", "1.00000000000000000001"])
def test_a_seed_that_a_double_would_round_is_refused(text: str) -> None:
    with pytest.raises(SceneError, match=f"seed: found {text}, expected a whole number from 0 to 9007199254740992"):
        parse_scene(f"{SMALLEST}\nseed: {text}")


@pytest.mark.parametrize("text", ["9007199254740991", "+9007199254740991", "9007199254740991.", "9.007199254740991e15"])
def test_a_long_seed_has_all_its_digits(text: str) -> None:
    assert parse_scene(f"{SMALLEST}\nseed: {text}").seed == 2**53 - 1


@pytest.mark.parametrize("text", ["1e-9", "1E-9", "1.0e-9", ".1e-8", "0.000000001", "+1e-9", "1.e-9"])
def test_ways_to_write_a_number(text: str) -> None:
    assert parse_scene(f"{SMALLEST}\nsolver: {{accuracy: {text}}}").solver.accuracy == pytest.approx(1e-9, rel=1e-15)


def test_an_attitude_within_the_tolerance_is_normalised() -> None:
    scene = parse_scene(SMALLEST + "\ninitial: {orientation: {x: 0, y: 0.6, z: 0, w: 0.8005}}")
    assert math.hypot(*scene.initial.orientation_xyzw) == pytest.approx(1.0, abs=4e-16)
    assert scene.initial.orientation_xyzw[3] / scene.initial.orientation_xyzw[1] == pytest.approx(0.8005 / 0.6)


def test_a_unit_quaternion_keeps_its_digits() -> None:
    digits = (0.17543859649122806, 0.3508771929824561, -0.5263157894736842, 0.7543859649122806)
    x, y, z, w = map(repr, digits)
    scene = parse_scene(f"{SMALLEST}\ninitial: {{orientation: {{x: {x}, y: {y}, z: {z}, w: {w}}}}}")
    assert scene.initial.orientation_xyzw == digits


def test_no_channels() -> None:
    assert parse_scene(SMALLEST + "\nwrenches: []").channels == ()


@pytest.mark.parametrize("method", ["auto", *METHODS])
def test_every_method_can_be_chosen_with_step_or_accuracy(method: str) -> None:
    assert parse_scene(f"{SMALLEST}\nsolver: {{method: {method}}}").solver == Solver(method, None, 1e-9)
    assert parse_scene(f"{SMALLEST}\nsolver: {{method: {method}, step: 1}}").solver == Solver(method, 1.0, None)


def test_an_alias_stands_for_its_value() -> None:
    scene = parse_scene(SMALLEST + "\ninitial: {position_world: &v [1, 2, 3], linear_velocity_world: *v}")
    assert scene.initial.position_world == scene.initial.linear_velocity_world == (1.0, 2.0, 3.0)


def test_read_scene_reads_a_file(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(
        b"\xef\xbb\xbf" + SMALLEST.encode() + b"\r\nduration: 3 # \xc3\xa9\r\n"
    )  # as Windows editors write
    scene = read_scene(str(path), {"duration": 4.0})
    assert scene.duration == 4.0
    assert scene.source == str(path)
    assert read_scene(path).duration == 3.0


@pytest.mark.parametrize(
    ("content", "fragments"),
    [
        (b"", ["empty"]),
        (b"\x00\x01\x02", ["'\\x00'", "UTF-8"]),
        (b"body: \xff\xfe\n", ["not UTF-8 at offset 6"]),
        (b"#" * ((1 << 20) + 1), ["more than 1048576 bytes"]),
        (b"body:\n  mass: -1\n  inertia: {diagonal: [1, 1, 1]}\n", [":2: body.mass: found -1"]),
    ],
    ids=["empty", "binary", "not UTF-8", "too large", "wrong value"],
)
def test_files_that_are_no_scene(tmp_path: Path, content: bytes, fragments: list[str]) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    for fragment in (f"{path}:", "expected", *fragments):
        assert fragment in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.yaml: found no readable file \(No such file.*check the path"):
        read_scene(tmp_path / "none.yaml")


def test_directory(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="found a folder, expected a scene in YAML; give the path of a file"):
        read_scene(tmp_path)
    (tmp_path / "a.yaml").write_text(SMALLEST)
    (tmp_path / "Metadata.txt").write_text("")
    with pytest.raises(SceneError, match=r"give a file in it, such as .*a\.yaml$"):
        read_scene(tmp_path)


def test_a_log_in_place_of_a_scene(example_dir: Path) -> None:
    with pytest.raises(SceneError, match=r"slew\.mcap: found an MCAP log, expected a scene .*rb-dynamics inspect "):
        read_scene(example_dir / "slew.mcap")


def test_path_with_null_byte() -> None:
    with pytest.raises(SceneError, match="null byte"):
        read_scene("a\0b")


def test_overrides_in_the_place_of_the_source_are_named() -> None:
    with pytest.raises(TypeError, match=r"source is .*write overrides="):
        parse_scene("body: {mass: 1}", {"duration": 1.0})  # type: ignore[arg-type]
