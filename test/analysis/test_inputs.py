"""What bags of other programs bring: an IMU, plain poses and twists, covariances, /tf, and the choice among topics."""

from __future__ import annotations

import itertools
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bag_rows import write_rows
from command_line import command
from foreign_bags import IMU, TF, header, imu, of, pose, poses_of, transform, transforms, twist, twists_of, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tumbling import spin

from rb_dynamics import LogError, TopicChoice, compare, inspect, parse_scene
from rb_dynamics.analysis.identification.flights import read_flight
from rb_dynamics.analysis.track import Track
from rb_dynamics.formats import cdr

COUNT = 400
MOTION = spin(count=COUNT)
POSES, TWISTS = poses_of(MOTION), twists_of(MOTION)
TIMES = MOTION.time_ns.tolist()
SCENE = "body: {frame: base, mass: 2.0, inertia: {diagonal: [1, 1, 1]}}\n"


def stamped(kind: str, rows: Any, wrap: Any, frame: str) -> list[Any]:
    return [of(kind, header(t, frame), wrap(row)) for t, row in zip(TIMES, rows, strict=True)]


def rows_of(topic: str, type_name: str, messages: list[Any], later: int = 0) -> list[Any]:
    return [(topic, type_name, t + later, message) for t, message in zip(TIMES, messages, strict=True)]


def with_covariance(kind: str, row: Any) -> Any:
    return of(f"{kind}WithCovariance", (pose if kind == "Pose" else twist)(row), np.ones(36))


def recorded(*parts: list[Any], sqlite: bool = False, **options: Any) -> Track:
    with tempfile.TemporaryDirectory() as folder:
        rows = sorted(itertools.chain(*parts), key=lambda row: row[2])
        return inspect(write_bag(Path(folder, "bag"), rows, sqlite), **options).track


PLAIN = (
    rows_of("/here", "geometry_msgs/msg/Pose", [pose(row) for row in POSES]),
    rows_of("/speed", "geometry_msgs/msg/Twist", [twist(row) for row in TWISTS]),
)
COVARIANCE = tuple(
    rows_of(
        f"/{kind.lower()}",
        f"geometry_msgs/msg/{kind}WithCovarianceStamped",
        stamped(f"{kind}WithCovarianceStamped", rows, lambda row, kind=kind: with_covariance(kind, row), frame),
    )
    for kind, rows, frame in (("Pose", POSES, "map"), ("Twist", TWISTS, "base"))
)
VICON = rows_of(
    "/vicon/brick",
    "geometry_msgs/msg/TransformStamped",
    [transform(t, "vicon", "brick", row) for t, row in zip(TIMES, POSES, strict=True)],
)


@pytest.mark.parametrize("sqlite", [False, True], ids=["mcap", "sqlite"])
@pytest.mark.parametrize("parts", [PLAIN, COVARIANCE], ids=["plain", "covariance"])
def test_pose_and_twist_of_every_kind(parts: Any, sqlite: bool) -> None:
    track = recorded(*parts, sqlite=sqlite)
    assert track.pose is not None
    assert track.twist is not None
    assert not track.twist_in_world
    np.testing.assert_array_equal(track.pose.values, POSES)
    np.testing.assert_array_equal(track.twist.values, TWISTS)


def test_rates_from_poses_with_their_noise() -> None:
    exact = recorded(VICON)
    assert exact.twist is None
    assert exact.rates is not None
    np.testing.assert_allclose(exact.rates.values[:, 3:], MOTION.rate[1:-1], rtol=1e-9)
    np.testing.assert_allclose(exact.rates.values[:, :3], TWISTS[1:-1, :3], atol=3e-5)
    noisy = spin(count=2000, noise=1e-3, rate=0.5)
    rows = [transform(t, "vicon", "brick", row) for t, row in zip(noisy.time_ns.tolist(), poses_of(noisy), strict=True)]
    stamps = [
        ("/v", "geometry_msgs/msg/TransformStamped", *each) for each in zip(noisy.time_ns.tolist(), rows, strict=True)
    ]
    track = recorded(stamps)
    assert track.rates is not None
    left = track.rates.values[:, 3:] - noisy.rate[1:-1]
    told = next(note for note in track.notes if "computed from /v" in note)
    said = float(told.split("noise of about ")[1].split(" rad/s")[0])
    # The square root of the sum over three axes; the median of sizes is a little less.
    assert said == pytest.approx(np.sqrt(np.mean(np.sum(left**2, axis=1))), rel=0.15)


def test_nothing_is_judged_by_computed_rates() -> None:
    found = inspect_of([VICON], scene=True)
    assert {check.name for check in found.summary.checks} >= {"/vicon/brick has no jumps"}
    assert not [check for check in found.summary.checks if "balance" in check.name or "fits" in check.name]
    assert any(moment.name == "angular velocity, body" for moment in found.summary.moments)


def inspect_of(parts: Any, scene: bool = False, **options: Any) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        text = Path(folder, "scene.yaml")
        text.write_text(SCENE)
        rows = sorted(itertools.chain(*parts), key=lambda row: row[2])
        return inspect(write_bag(Path(folder, "bag"), rows), text if scene else None, **options)


def imu_rows(measured: tuple[bool, bool, bool]) -> list[Any]:
    force = np.tile([0.1, -0.2, 9.8], (COUNT, 1))
    parts = zip(TIMES, MOTION.orientation_xyzw, MOTION.rate, force, strict=True)
    return rows_of("/imu/data", IMU, [imu(*part, measured) for part in parts])


@pytest.mark.parametrize("oriented", [True, False])
def test_an_imu_gives_what_it_measures(oriented: bool) -> None:
    found = inspect_of([imu_rows((oriented, True, True))], scene=True)
    track, summary = found.track, found.summary
    assert track.twist is not None
    np.testing.assert_array_equal(track.twist.values[:, 3:], MOTION.rate)
    assert np.isnan(track.twist.values[:, :3]).all()
    np.testing.assert_array_equal(track.specific_force.values, np.tile([0.1, -0.2, 9.8], (COUNT, 1)))
    assert (track.pose is not None) == oriented
    assert {m.name for m in summary.moments} >= {"angular velocity, body", "specific force, sensor"}
    assert "linear velocity, body" not in {m.name for m in summary.moments}
    assert any("has only the angular velocity" in each for each in summary.missing)
    (instead,) = (check.detail for check in summary.checks if check.name == "inertia explains the motion")
    assert "not judged; " in instead
    assert ": rb-dynamics identify /" in instead
    assert any("(imu_link) are taken for those of the body" in each for each in summary.notes)
    if oriented:
        np.testing.assert_array_equal(track.pose.values[:, 3:], MOTION.orientation_xyzw)
        agrees = next(c for c in summary.checks if c.name == "angular velocity fits the attitude")
        assert agrees.judged
        assert agrees.passed
        assert track.angular_momentum is not None
        assert track.linear_momentum is None
        assert found.as_dict()["moments"]


@pytest.mark.parametrize("by", ["scene", "tf_static"])
def test_the_axes_of_an_imu_are_turned_to_those_of_the_body(by: str, tmp_path: Path) -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 2.0])
    force = np.array([0.1, -0.2, 9.8])
    attitude = (Rotation.from_quat(MOTION.orientation_xyzw) * turn).as_quat()
    parts = zip(TIMES, attitude, turn.inv().apply(MOTION.rate), [turn.inv().apply(force)] * COUNT, strict=True)
    rows = rows_of("/imu", IMU, [imu(*part, (True, True, True)) for part in parts])
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    if by == "scene":
        x, y, z, w = turn.as_quat().tolist()
        frame = f"{{position: [0, 0, 0], orientation: {{x: {x!r}, y: {y!r}, z: {z!r}, w: {w!r}}}}}"
        scene.write_text(SCENE.replace("inertia:", f"frames: {{imu_link: {frame}}}, inertia:"))
    else:
        mounted = transforms([transform(0, "base", "imu_link", [1.0, 2.0, 3.0, *turn.as_quat()])])
        rows = [("/tf_static", TF, 0, mounted), *rows]
    track = inspect(write_bag(tmp_path / "bag", rows), scene).track
    np.testing.assert_allclose(track.twist.values[:, 3:], MOTION.rate, atol=1e-14)
    np.testing.assert_allclose(track.specific_force.values, [force] * COUNT, atol=1e-14)
    apart = Rotation.from_quat(track.pose.values[:, 3:]).inv()
    assert (apart * Rotation.from_quat(MOTION.orientation_xyzw)).magnitude().max() < 1e-7
    assert any(f"turned to those of {'the body' if by == 'scene' else 'base'}, as" in note for note in track.notes)


def test_an_imu_without_gyro_is_no_twist() -> None:
    track = recorded(VICON, imu_rows((True, False, True)))
    assert track.twist is None
    assert track.rates is not None
    assert track.uses["/vicon/brick"] == "pose"


@settings(max_examples=8)
@given(
    seed=st.integers(0, 2**32 - 1),
    fixed=st.booleans(),
    sqlite=st.booleans(),
    extra=st.lists(st.sampled_from(["arm", "wheel_left", "ψ"]), max_size=3, unique=True),
)
def test_frames_compose_as_scipy_does(seed: int, fixed: bool, sqlite: bool, extra: list[str]) -> None:
    random = np.random.default_rng(seed)
    outer = np.hstack([random.standard_normal(3), Rotation.random(rng=random).as_quat()])
    inner = np.hstack([random.standard_normal(3), Rotation.random(rng=random).as_quat()])
    rows: list[Any] = []
    for t, row in zip(TIMES, POSES, strict=True):
        others = [transform(t, "base", name, inner) for name in extra]
        # Messages of several lengths, and two publishers of one topic.
        rows.append(("/tf", TF, t, transforms([transform(t, "odom", "base", row), *others])))
        if not fixed:
            rows.append(("/tf", TF, t + 1, transforms([transform(t, "map", "odom", outer)])))
    static = [transform(0, "base", "camera", inner)]
    if fixed:
        static.append(transform(0, "map", "odom", outer))
    rows.append(("/tf_static", TF, 0, transforms(static)))
    track = recorded(rows, sqlite=sqlite, topics=TopicChoice(frames=("map", "camera")))
    assert track.pose is not None
    turns = Rotation.from_quat(outer[3:]) * Rotation.from_quat(POSES[:, 3:])
    places = outer[:3] + Rotation.from_quat(outer[3:]).apply(POSES[:, :3]) + turns.apply(inner[:3])
    np.testing.assert_allclose(track.pose.values[:, :3], places, atol=1e-12)
    apart = (turns * Rotation.from_quat(inner[3:])).inv() * Rotation.from_quat(track.pose.values[:, 3:])
    assert apart.magnitude().max() < 1e-7
    assert track.pose.frame == "map"
    assert {"/tf odom:base", *(f"/tf base:{name}" for name in extra)} <= track.bag.topics.keys()
    # The other way round.
    back = recorded(rows, topics=TopicChoice(frames=("base", "odom"))).pose
    assert back is not None
    np.testing.assert_allclose(
        back.values[:, :3], -Rotation.from_quat(POSES[:, 3:]).inv().apply(POSES[:, :3]), atol=1e-12
    )


def test_transforms_that_lead_to_a_frame_in_two_ways_are_named(tmp_path: Path) -> None:
    turned = [0.0, 0.0, 0.0, 0.0, 0.0, np.sin(0.1), np.cos(0.1)]
    static = [("/tf_static", TF, 0, transforms([transform(0, "map", "odom", turned)]))]
    both = [
        ("/tf", TF, t, transforms([transform(t, "odom", "base", row), transform(t, "map", "base", row)]))
        for t, row in zip(TIMES, POSES, strict=True)
    ]
    bag = write_bag(tmp_path / "bag", [*static, *both])
    places = Rotation.from_quat(turned[3:]).apply(POSES[:, :3]) - POSES[:, :3]
    far = f"up to {np.linalg.norm(places, axis=1).max():.3g} m and 0.2 rad apart"
    told = rf"also lead from map to base by /tf_static map:odom, /tf odom:base, .* {far}"
    choice = TopicChoice(frames=("map", "base"))
    assert [note for note in inspect(bag, topics=choice).track.notes if re.search(told, note)]
    assert re.search(told, command("convert", bag, tmp_path / "poses.csv", "--frames", "map:base").stderr)
    alone = write_bag(
        tmp_path / "tree",
        [
            *static,
            *[
                (a, b, t, transforms([transform(t, "odom", "base", row)]))
                for (a, b, t, _), row in zip(both, POSES, strict=True)
            ],
        ],
    )
    assert not [note for note in inspect(alone, topics=choice).track.notes if "also lead" in note]
    assert [note for note in compare(bag, alone, topics=choice).notes if re.search(told, note)]


@pytest.mark.parametrize(("other", "count"), [("/r2/tf", COUNT), ("/tf_static", 1)])
def test_two_topics_that_join_the_same_frames_are_named(tmp_path: Path, other: str, count: int) -> None:
    rows = [
        (topic, TF, t, transforms([transform(t, "odom", "base", [moved, 0.0, 0.0, *row[3:]])]))
        for topic, moved, size in (("/r1/tf", 0.0, COUNT), (other, 5.0, count))
        for t, row in zip(TIMES[:size], POSES, strict=False)
    ]
    # What is fixed is recorded first, and yet what moves counts.
    bag = write_bag(tmp_path / "bag", rows[::-1] if count == 1 else rows)
    track = inspect(bag, topics=TopicChoice(frames=("odom", "base"))).track
    assert track.pose is not None
    assert track.pose.values[:, 0].tolist() == [0.0] * COUNT
    told = rf"also lead from odom to base by {other} odom:base, .* up to 5 m and .* rad apart"
    assert [note for note in track.notes if re.search(told, note)]
    table = tmp_path / "poses.csv"
    assert re.search(told, command("convert", bag, table, "--frames", "odom:base").stderr)
    assert len(table.read_text().splitlines()) == 1 + len(TIMES)


def test_one_moving_frame_is_the_pose_and_of_several_none_is_guessed() -> None:
    one = [("/tf", TF, t, transforms([transform(t, "map", "base", row)])) for t, row in zip(TIMES, POSES, strict=True)]
    np.testing.assert_array_equal(recorded(one).pose.values, POSES)
    two = [("/tf", TF, t, transforms([transform(t, "base", "arm", row)])) for t, row in zip(TIMES, POSES, strict=True)]
    with pytest.raises(LogError, match=r"several frames move \(base:arm, map:base\).*--frames WORLD:BODY"):
        recorded(one, two)


def test_others_say_how_to_choose_among_several_moving_frames(tmp_path: Path) -> None:
    rows: list[Any] = [
        ("/tf", TF, t, transforms([transform(t, frame, child, row)]))
        for t, row in zip(TIMES, POSES, strict=True)
        for frame, child in (("map", "base"), ("base", "arm"))
    ]
    pushed = of("Wrench", of("Vector3", 1.0, 0.0, 0.0), of("Vector3", 0.0, 0.0, 0.0))
    rows += [("/w", "geometry_msgs/msg/WrenchStamped", TIMES[0], of("WrenchStamped", header(TIMES[0], "base"), pushed))]
    with pytest.raises(LogError, match=r"found 0 samples .*; .*several frames move .* --frames WORLD:BODY; record the"):
        read_flight(str(bag := write_bag(tmp_path / "bag", rows)), parse_scene(SCENE))
    with pytest.raises(LogError, match=r"no pose and no twist, .*several frames move .* --frames WORLD:BODY; to run"):
        compare(bag, bag)


def test_the_topic_of_transforms_is_used_for_what_its_frames_are() -> None:
    rows = [("/tf", TF, t, transforms([transform(t, "map", "base", row)])) for t, row in zip(TIMES, POSES, strict=True)]
    assert uses_of(rows) == {"/tf": "pose", "/tf map:base": "pose"}
    assert uses_of(rows, VICON)["/tf"] == "(another used)"


def uses_of(*parts: Any) -> dict[str, str]:
    return {topic.name: topic.use for topic in inspect_of(parts).summary.topics}


def test_what_is_named_like_a_command_is_no_measurement() -> None:
    cmd = rows_of("/cmd_vel", "geometry_msgs/msg/Twist", [twist(row) for row in TWISTS])
    track = recorded(VICON, cmd)
    assert track.twist is None
    assert any("/cmd_vel: named like a command" in note for note in track.notes)
    assert recorded(VICON, cmd, topics=TopicChoice(twist="cmd_vel")).twist is not None


def test_an_unknown_topic_lists_those_there_are(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", sorted([*VICON, *imu_rows((False, True, True))], key=lambda row: row[2]))
    found = command("inspect", bag, "--pose-topic", "/nowhere")
    assert found.returncode == 2
    assert "expected one of: /vicon/brick (geometry_msgs/msg/TransformStamped, 400 messages)" in found.stderr
    found = command("inspect", bag, "--twist-topic", "/vicon/brick")
    assert "found geometry_msgs/msg/TransformStamped, 400 messages, expected one of: /imu/data" in found.stderr
    assert command("inspect", bag, "--wrench-topic", "w").returncode == 2
    assert "there are vicon:brick" in command("inspect", bag, "--frames", "a:b").stderr
    assert command("inspect", bag, "--frames", "a").returncode == 2
    assert command("inspect", bag, "--frames", "a:b", "--pose-topic", "c").returncode == 2
    assert command("inspect", bag, "--frames", "vicon:brick", "--twist-topic", "imu/data").returncode == 0


def test_a_bag_without_anything_to_inspect_shows_its_topics(tmp_path: Path) -> None:
    message = of("std_msgs/msg/String", "hello")
    bag = write_bag(tmp_path / "bag", [("/chatter", "std_msgs/msg/String", t, message) for t in TIMES])
    found = command("inspect", bag)
    assert found.returncode == 2
    assert "\n  /chatter  std_msgs/msg/String  400 messages  100 Hz" in found.stderr


def test_damaged_transforms_spoil_nothing_else(tmp_path: Path) -> None:
    rows = [
        ("/pose", "geometry_msgs/msg/PoseStamped", t, cdr.encode("geometry_msgs/msg/PoseStamped", t, "map", row))
        for t, row in zip(TIMES, POSES.tolist(), strict=True)
    ]
    bag = write_rows(tmp_path / "bag.mcap", [*rows, ("/tf", TF, 0, b"\0\1\0\0\5\0\0\0")])
    assert inspect(bag).track.pose is not None
    with pytest.raises(LogError, match="TFMessage: message ends after 8 bytes"):
        inspect(bag, topics=TopicChoice(frames=("a", "b")))


def test_compare_takes_the_topics_that_are_named(tmp_path: Path) -> None:
    late = [("/other", *rest) for _, *rest in rows_of("", "geometry_msgs/msg/Pose", [pose(row) for row in POSES[::-1]])]
    bag = write_bag(tmp_path / "bag", sorted([*VICON, *late], key=lambda row: row[2]))
    same = command("compare", bag, bag, "--pose-topic", "/other", "--bound", "0")
    assert same.returncode == 0
    assert "expected one of: /vicon/brick" in command("compare", bag, bag, "--pose-topic", "nowhere").stderr


FIXED = Rotation.from_euler("xyz", [0.3, -0.2, 2.0])
PLACE = np.array([0.2, 0.1, -0.3])


def seen_at(kind: str) -> list[Any]:
    """Return what the frame `camera`, which is fixed to the body, shows of the motion."""
    attitudes = Rotation.from_quat(MOTION.orientation_xyzw)
    poses = np.hstack([MOTION.position + attitudes.apply(PLACE), (attitudes * FIXED).as_quat()])
    velocity = attitudes.inv().apply(MOTION.velocity) + np.cross(MOTION.rate, PLACE)
    twists = np.hstack([FIXED.inv().apply(velocity), FIXED.inv().apply(MOTION.rate)])
    if kind == "tf":
        moving = [transforms([transform(t, "world", "camera", row)]) for t, row in zip(TIMES, poses, strict=True)]
        return rows_of("/tf", TF, moving)
    if kind == "twist":
        told = stamped("TwistStamped", twists, twist, "camera")
        return [*VICON, *rows_of("/twist", "geometry_msgs/msg/TwistStamped", told)]
    both = zip(TIMES, poses, twists, strict=True)
    odometry = [
        of(
            "nav_msgs/msg/Odometry", header(t, "world"), "camera",
            of("PoseWithCovariance", pose(place), np.zeros(36)), of("TwistWithCovariance", twist(speed), np.zeros(36)),
        )
        for t, place, speed in both
    ]  # fmt: skip
    return rows_of("/odom", "nav_msgs/msg/Odometry", odometry)


@pytest.mark.parametrize("by", ["scene", "tf_static"])
@pytest.mark.parametrize("kind", ["odom", "twist", "tf"])
def test_pose_and_twist_of_a_frame_fixed_to_the_body_are_converted(kind: str, by: str, tmp_path: Path) -> None:
    scene, rows = tmp_path / "scene.yaml", seen_at(kind)
    x, y, z, w = FIXED.as_quat().tolist()
    frame = f"{{position: {PLACE.tolist()}, orientation: {{x: {x!r}, y: {y!r}, z: {z!r}, w: {w!r}}}}}"
    scene.write_text(SCENE.replace("inertia:", f"frames: {{camera: {frame}}}, inertia:") if by == "scene" else SCENE)
    if by == "tf_static":
        rows = [("/tf_static", TF, 0, transforms([transform(0, "base", "camera", [*PLACE, x, y, z, w])])), *rows]
    track = inspect(write_bag(tmp_path / "bag", rows), scene).track

    assert track.pose is not None
    np.testing.assert_allclose(track.pose.values[:, :3], MOTION.position, atol=1e-12)
    apart = Rotation.from_quat(track.pose.values[:, 3:]).inv() * Rotation.from_quat(MOTION.orientation_xyzw)
    assert apart.magnitude().max() < 1e-7
    if kind != "tf":
        assert track.twist is not None
        np.testing.assert_allclose(track.twist.values, TWISTS, atol=1e-12)
        assert track.twist.frame == "base"
    assert any("tells of camera: its " in note for note in track.notes)


def test_a_frame_that_nobody_declares_is_the_bodys(tmp_path: Path) -> None:
    track = inspect(write_bag(tmp_path / "bag", seen_at("odom"))).track
    assert track.pose is not None
    assert not any("camera" in note for note in track.notes)
    assert np.abs(track.pose.values[:, :3] - MOTION.position).max() > 0.1


def test_a_frame_that_is_fixed_to_another_than_the_scenes_is_told(tmp_path: Path) -> None:
    fixed = transforms([transform(0, "hull", "camera", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])])
    (tmp_path / "scene.yaml").write_text(SCENE)
    bag = write_bag(tmp_path / "bag", [("/tf_static", TF, 0, fixed), *seen_at("odom")])
    notes = inspect(bag, tmp_path / "scene.yaml").track.notes
    assert any("camera is taken for the frame of the body" in note and "fixed to hull" in note for note in notes)


def test_a_frame_of_another_name_than_the_scene_gives_the_bodys_is_told(tmp_path: Path) -> None:
    """A marker was taken for the body without a word, and its numbers for those of the body."""
    bag = write_bag(tmp_path / "bag", seen_at("odom"))
    notes = []
    for name in ("base", "ship/camera", "body"):
        (tmp_path / "scene.yaml").write_text(SCENE.replace("frame: base", f"frame: {name}"))
        notes.append("".join(note for note in inspect(bag, tmp_path / "scene.yaml").track.notes if "taken for" in note))
    assert "camera is taken for the frame of the body, which the scene calls 'base'" in notes[0]
    assert notes[1:] == ["", ""]


def test_samples_that_are_recorded_twice_are_counted() -> None:
    with tempfile.TemporaryDirectory() as folder:
        rows = sorted([*seen_at("odom"), *seen_at("odom")], key=lambda row: row[2])
        checks = inspect(write_bag(Path(folder, "bag"), rows)).summary.checks
    (whole,) = (check.detail for check in checks if check.name == "/odom is whole")
    assert f"{2 * COUNT} samples, of which {COUNT} repeat the one before, with its time" in whole


def test_compare_takes_the_rates_of_an_imu_that_are_turned_for_those_of_the_body(tmp_path: Path) -> None:
    """They were said to be of its frame, with the advice to give the scene that was given."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    mounted = transforms([transform(0, "base", "imu_link", [*PLACE, *FIXED.as_quat()])])
    twists = rows_of("/twist", "geometry_msgs/msg/TwistStamped", stamped("TwistStamped", TWISTS, twist, "base"))
    one = write_bag(tmp_path / "one", sorted([*VICON, *twists], key=lambda row: row[2]))
    for name, fixed, noted in (("two", [("/tf_static", TF, 0, mounted)], 0), ("three", [], 1)):
        rows = sorted([*VICON, *fixed, *imu_rows((False, True, True))], key=lambda row: row[2])
        notes = compare(one, write_bag(tmp_path / name, rows), scene=scene).notes
        assert len([each for each in notes if "one body frame" in each]) == noted


def test_compare_says_where_a_bag_says_how_its_frame_is_fixed_to_the_other(tmp_path: Path) -> None:
    plain = [
        *VICON,
        *rows_of("/twist", "geometry_msgs/msg/TwistStamped", stamped("TwistStamped", TWISTS, twist, "base")),
    ]
    mounted = transforms([transform(0, "base", "camera", [*PLACE, *FIXED.as_quat()])])
    one = write_bag(tmp_path / "one", plain)
    for name, rows, said in (
        ("two", seen_at("odom"), "which nothing in the recordings says"),
        ("three", [("/tf_static", TF, 0, mounted), *seen_at("odom")], "says how they are fixed to each other"),
    ):
        notes = compare(one, write_bag(tmp_path / name, rows)).notes
        (note,) = (each for each in notes if "they are taken as one body frame" in each)
        assert said in note
    (tmp_path / "scene.yaml").write_text(SCENE)
    found = compare(one, tmp_path / "three", scene=tmp_path / "scene.yaml")
    assert not any("one body frame" in each for each in found.notes)
    assert found.differences["linear_velocity"].max < 1e-9


@pytest.mark.parametrize("paused_ns", [0, 1_500_000_000])
def test_what_has_no_stamps_is_put_beside_the_motion_of_a_simulation(paused_ns: int) -> None:
    """Energies, and states that were set from outside, stood at their log times, years after the motion."""
    middle = TIMES[COUNT // 2]
    later = [1_796_000_000_000_000_000 + paused_ns * (t > middle) for t in TIMES]
    logged = [t + more for t, more in zip(TIMES, later, strict=True)]
    number = "std_msgs/msg/Float64"
    moved = of(
        "nav_msgs/msg/Odometry", header(0, ""), "", of("PoseWithCovariance", pose(POSES[0]), np.zeros(36)),
        of("TwistWithCovariance", twist(TWISTS[0]), np.zeros(36)),
    )  # fmt: skip
    at = 300
    track = recorded(
        [
            ("/sat/pose", "geometry_msgs/msg/PoseStamped", t, message)
            for t, message in zip(logged, stamped("PoseStamped", POSES, pose, "map"), strict=True)
        ],
        [("/sat/energy/kinetic", number, t + 100_000, of(number, 1.0)) for t in logged],
        [("/sat/rigid_body/set_state", "nav_msgs/msg/Odometry", logged[at] + 100_000, moved)],
    )
    assert track.kinetic_energy is not None
    late = track.kinetic_energy.time_ns - TIMES
    assert 0 <= late.min() <= late.max() <= 200_000
    assert 0 <= track.moved_ns[0] - TIMES[at] <= 200_000
    assert sum("Energies have no stamps" in note for note in track.notes) == 1


def test_one_message_of_a_twist_is_inspected() -> None:
    """It ended with a traceback."""
    track = recorded(PLAIN[0], PLAIN[1][:1])
    assert track.twist is not None
    assert len(track.twist.time_ns) == 1


def test_a_state_that_is_set_is_no_measured_twist() -> None:
    """Without another twist, the states that somebody set were taken for one, which contradicted the pose."""
    kind = "nav_msgs/msg/Odometry"
    pose_in, twist_in = (
        of(f"{name}WithCovariance", row, np.zeros(36))
        for name, row in (("Pose", pose(POSES[0])), ("Twist", twist(TWISTS[0])))
    )
    states = [of(kind, header(t, "map"), "base", pose_in, twist_in) for t in TIMES]
    assert recorded(PLAIN[0], rows_of("/sat/rigid_body/set_state", kind, states)).twist is None


@pytest.mark.parametrize("late_ns", [-30_000_000, 0, 30_000_000])
def test_a_body_was_moved_where_its_pose_leaps(late_ns: int) -> None:
    """Another program logs set_state some milliseconds off, on the other side of a sample: the pose "jumped"."""
    kind, at = "nav_msgs/msg/Odometry", 300
    rows = POSES.copy()
    rows[at + 1 :, :3] += (1.0, -2.0, 0.5)
    pose_in, twist_in = (
        of(f"{name}WithCovariance", row, np.zeros(36))
        for name, row in (("Pose", pose(rows[at + 1])), ("Twist", twist(TWISTS[at + 1])))
    )
    state = of(kind, header(0, ""), "", pose_in, twist_in)
    track = recorded(
        rows_of("/pose", "geometry_msgs/msg/PoseStamped", stamped("PoseStamped", rows, pose, "map")),
        [("/set_state", kind, TIMES[at] + late_ns, state)],
    )
    assert track.moved_ns.tolist() == [TIMES[at]]
