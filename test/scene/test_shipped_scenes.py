"""The scenes in config/ are valid and match their recordings and references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.scene.model import Channel, Solver
from rb_dynamics.scene.read import parse_scene, read_scene

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda path: path.name)
def test_every_shipped_scene_is_valid(path: Path) -> None:
    scene = read_scene(path)
    assert scene.source == str(path)
    if path.stem in ("mesh", "urdf"):  # what the file beside it says stands in the text
        assert scene.text.startswith(f"# {path} with the body that ")
        assert parse_scene(scene.text, str(path)) == scene
    else:
        assert scene.text == path.read_text(encoding="utf-8")


def test_a_bare_name_that_is_no_file_here_is_that_of_a_shipped_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert read_scene("slew.yaml") == read_scene(ROOT / "config" / "slew.yaml")
    for wrong in ("./slew.yaml", "config/slew.yaml", "no_such.yaml", ""):
        with pytest.raises(SceneError, match="found no readable file"):
            read_scene(wrong)
    Path("slew.yaml").write_text("body: {mass: 3}\n", encoding="utf-8")
    assert read_scene("slew.yaml").body.mass == 3.0


def test_slew_starts_where_the_recorded_body_started() -> None:
    scene = read_scene(ROOT / "config" / "slew.yaml")
    first: dict[str, Any] = {}
    highlevel = pytest.importorskip("rosbags.highlevel", reason="extra 'log' is not installed")
    with highlevel.AnyReader([ROOT / "examples" / "slew.mcap"]) as reader:
        topics = {connection.topic for connection in reader.connections}
        for connection, _, raw in reader.messages():
            first.setdefault(connection.topic, reader.deserialize(raw, connection.msgtype))
            if len(first) == len(topics):
                break
    pose, twist = first["/truth/pose"].pose, first["/truth/twist"].twist
    assert scene.initial.time_ns == 0
    assert scene.initial.position_world == (pose.position.x, pose.position.y, pose.position.z)
    assert scene.initial.orientation_xyzw == tuple(getattr(pose.orientation, c) for c in "xyzw")
    assert scene.initial.angular_velocity_body == (twist.angular.x, twist.angular.y, twist.angular.z)
    # The origin is at rest, so the axes of the linear twist do not matter.
    assert scene.initial.linear_velocity_world == (0.0, 0.0, 0.0)
    assert (twist.linear.x, twist.linear.y, twist.linear.z) == (0.0, 0.0, 0.0)
    assert {"/" + channel.topic for channel in scene.channels} == {t for t in topics if t.startswith("/wrench/")}
    assert first["/wrench/body"].header.frame_id == scene.frames.body_frame
    assert first["/wrench/world"].header.frame_id == scene.frames.world_frame


def test_slew_is_the_recorded_flight() -> None:
    scene = read_scene(ROOT / "config" / "slew.yaml")
    assert scene.body.mass == 16.8
    assert scene.body.inertia == ((0.2975, 0.0021, -0.0008), (0.0021, 0.2930, 0.0013), (-0.0008, 0.0013, 0.3104))
    assert scene.channels == (Channel("wrench/body"), Channel("wrench/world"))
    assert scene.solver == Solver("rkmk4", 0.01, None)
    assert (scene.duration, scene.output_rate) == (60.0, 100.0)


def test_dzhanibekov_is_the_reference_case() -> None:
    scene = read_scene(ROOT / "config" / "dzhanibekov.yaml")
    assert scene.body.mass == 1.0
    assert scene.body.principal_moments == (1.0, 2.0, 3.0)
    assert scene.initial.linear_velocity_world == (0.3, -0.1, 0.2)
    assert scene.initial.angular_velocity_body == (0.1, 2.0, 0.1)
    assert scene.channels == ()
    assert scene.solver == Solver("auto", None, 1e-9)
    assert scene.duration == 100.0
