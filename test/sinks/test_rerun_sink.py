"""`RerunSink`: the file, read with Rerun's reader, has the values of the run."""

from __future__ import annotations

import errno
import math
import os
import re
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun_runs import BODY, COMMANDS, SCENE, Rrd, logged

from rb_dynamics.body.inertia_quantities import equivalent_box
from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics import rotation
from rb_dynamics.numerics.vector import ZERO
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.sink import AppliedWrench, Event, RunInfo, Status
from rb_dynamics.scene import parse_scene, read_scene
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.read import UNSAID
from rb_dynamics.sinks.rerun_sink import RerunSink, sending_to


def still(index: int, period_ns: int = 1_000_000) -> Sample:
    """Return a sample whose position encodes its index."""
    place, identity = (float(index), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    return Sample(index * period_ns, place, identity, ZERO, ZERO, ZERO, ZERO, 0.0, 0.0, 0.0, ZERO, ZERO)


def written(path: Path, events: list[Event], scene: Scene = SCENE, **options: int) -> Rrd:
    sink = RerunSink(path, **options)
    sink.open(RunInfo(scene, "rk4"))
    for event in events:
        sink.write(event)
    sink.close({})
    return Rrd(path)


@pytest.mark.parametrize("batch_rows", [7, 64, 2048])
def test_every_field_comes_back_bit_for_bit(tmp_path: Path, batch_rows: int) -> None:
    rrd, samples = logged(tmp_path, batch_rows=batch_rows)
    fields = {
        "position": "position_world",
        "attitude": "orientation_xyzw",
        "linear_velocity": "linear_velocity_world",
        "angular_velocity": "angular_velocity_body",
        "angular_momentum": "angular_momentum_world",
        "linear_momentum": "linear_momentum_world",
        "energy/kinetic": "kinetic_energy",
        "energy/work": "work",
        "energy/defect": "energy_defect",
        "angular_momentum/defect": "angular_momentum_defect_world",
        "linear_momentum/defect": "linear_momentum_defect_world",
    }
    assert len(samples) == 301
    assert samples[-1].kinetic_energy != samples[0].kinetic_energy
    for entity, name in fields.items():
        expected = np.array([getattr(sample, name) for sample in samples]).reshape(len(samples), -1)
        np.testing.assert_array_equal(rrd.values(entity), expected, err_msg=entity)
        assert rrd.times(entity) == [sample.time_ns for sample in samples]
        assert rrd.indices(entity) == list(range(len(samples)))
    if batch_rows == 7:
        assert rrd.batches > 10


def test_poses_are_those_of_the_body_and_of_its_center_of_mass(tmp_path: Path) -> None:
    rrd, samples = logged(tmp_path)
    position = np.array([sample.position_world for sample in samples])
    attitude = np.array([sample.orientation_xyzw for sample in samples])
    center = [
        np.add(sample.position_world, rotation.rotate(sample.orientation_xyzw, BODY.center_of_mass))
        for sample in samples
    ]
    for entity, component, expected in (
        ("world/body", "Transform3D:translation", position),
        ("world/body", "Transform3D:quaternion", attitude),
        ("world/center_of_mass", "Transform3D:translation", np.array(center)),
    ):
        np.testing.assert_allclose(rrd.values(entity, component)[:, 0], expected, rtol=0, atol=5e-7, err_msg=entity)
    path = np.array(rrd.static("world/path/center_of_mass", "LineStrips3D:strips")[0])
    np.testing.assert_allclose(path[:-1], center, rtol=0, atol=5e-7)
    np.testing.assert_allclose(path[-1], center[-1], rtol=0, atol=5e-7)
    assert len(rrd.static("world/path/body_origin", "LineStrips3D:strips")[0]) == len(samples) + 1


def test_the_box_has_mass_and_inertia_of_the_body(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path)
    half = np.array(rrd.static("world/body/box", "Boxes3D:half_sizes")[0])
    squares = half**2
    moments = BODY.mass / 3.0 * (squares.sum() - squares)
    np.testing.assert_allclose(moments, BODY.principal_moments, rtol=1e-6)
    np.testing.assert_allclose(rrd.static("world/body/box", "Boxes3D:centers")[0], BODY.center_of_mass, rtol=1e-6)
    np.testing.assert_allclose(
        rrd.static("world/body/box", "Boxes3D:quaternions")[0], BODY.principal_orientation_xyzw, rtol=1e-6
    )


def test_a_body_from_a_mesh_looks_like_its_mesh(tmp_path: Path, scene_dir: Path) -> None:
    pytest.importorskip("trimesh")
    scene = read_scene(scene_dir / "mesh.yaml", {"duration": 0.1})
    rrd, _ = logged(tmp_path, scene, commands=())
    corners = np.array(rrd.static("world/body/mesh", "Mesh3D:vertex_positions"))
    normals = np.array(rrd.static("world/body/mesh", "Mesh3D:vertex_normals"))
    volume = np.linalg.det(corners.reshape(-1, 3, 3)).sum() / 6.0
    assert volume * 720.0 == pytest.approx(scene.body.mass, rel=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-6)
    assert ("/world/body/box", "Boxes3D:half_sizes") not in rrd.rows
    assert "is its mesh" in rrd.static("about", "TextDocument:text")[0]


def test_arrows_have_the_direction_of_their_vectors_and_fit_the_body(tmp_path: Path) -> None:
    rrd, samples = logged(tmp_path)
    size = equivalent_box(BODY)[1]
    for name, vectors, length in (
        ("angular_momentum", [sample.angular_momentum_world for sample in samples], 3.0),
        ("angular_velocity", [rotation.rotate(s.orientation_xyzw, s.angular_velocity_body) for s in samples], 1.9),
    ):
        entity = f"world/center_of_mass/{name}"
        arrows = rrd.values(entity, "Arrows3D:vectors")[:, 0]
        norms = np.linalg.norm(vectors, axis=1)
        np.testing.assert_allclose(arrows, np.array(vectors) / np.sqrt(norms)[:, None], rtol=0, atol=1e-6)
        drawn = np.linalg.norm(arrows, axis=1) * np.array(rrd.static(entity, "Transform3D:scale")[0])[0]
        assert drawn.max() == pytest.approx(length * size, rel=1e-5)


def test_force_and_torque_arrows_show_only_while_they_act_and_turn_with_their_frame(tmp_path: Path) -> None:
    rrd, samples = logged(tmp_path)
    arrows = {index: value for _, index, value in rrd.rows["/world/center_of_mass/force", "Arrows3D:vectors"]}
    for index, sample in enumerate(samples):
        if 505_000_000 <= sample.time_ns < 1_000_000_000:
            expected = rotation.rotate(sample.orientation_xyzw, (1.0, 0.0, 0.0))
        elif 1_000_000_000 <= sample.time_ns < 2_000_000_000:
            expected = (0.0, math.sqrt(2.0), 0.0)
        else:
            assert arrows.get(index, []) == []
            continue
        np.testing.assert_allclose(arrows[index][0], expected, rtol=0, atol=1e-6)
    torques = rrd.rows["/world/center_of_mass/torque", "Arrows3D:vectors"]
    assert [index for _, index, value in torques if value] == list(range(51, 100))


def test_wrench_series_have_their_edges_when_they_took_effect(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path)
    milliseconds = [time // 1_000_000 for time in rrd.times("force/wrench/body")]
    assert milliseconds == [0, 505, 1000, 3000]
    assert rrd.values("force/wrench/body")[:, 0].tolist() == [0.0, 1.0, 0.0, 0.0]
    assert rrd.values("torque/wrench/body")[:, 2].tolist() == [0.0, 0.5, 0.0, 0.0]
    assert [time // 1_000_000 for time in rrd.times("force/wrench/world")] == [0, 1000, 2000, 3000]
    assert rrd.values("force/wrench/world")[:, 1].tolist() == [0.0, 2.0, 0.0, 0.0]
    assert not {"/torque/wrench/world", "/force/other/body", "/force/none"} & {entity for entity, _ in rrd.rows}


def test_a_run_without_wrenches_has_plots_that_say_so(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path, commands=())
    for kind in ("force", "torque"):
        assert rrd.times(f"{kind}/none") == [0, 3_000_000_000]
        assert rrd.values(f"{kind}/none").ravel().tolist() == [0.0, 0.0]


def test_channels_add_up(tmp_path: Path) -> None:
    events = [
        still(0),
        AppliedWrench(0, "wrench", None, "world", (1.0, 0.0, 0.0), ZERO),
        AppliedWrench(0, "other/arm", None, "body", (0.0, 3.0, 0.0), ZERO),
        still(1),
    ]
    rrd = written(tmp_path / "a.rrd", events)
    arrows = rrd.values("world/center_of_mass/force", "Arrows3D:vectors")[:, 0]
    np.testing.assert_allclose(arrows, np.array([[1.0, 3.0, 0.0]] * 2) / 10.0**0.25, rtol=1e-6)
    assert rrd.values("force/other/arm/body")[:, 1].tolist() == [0.0, 3.0, 3.0]


def test_the_file_opens_with_a_layout_facts_and_the_scene(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path)
    assert len(rrd.reader.recordings()) == 1
    for store in rrd.reader.blueprints():
        column = "ViewBlueprint:class_identifier"
        batches = [chunk.to_record_batch() for chunk in rrd.reader.stream(store=store).to_chunks()]
        found = [batch.column(column).to_pylist() for batch in batches if column in batch.schema.names]
        kinds = [kind for rows in found for (kind,) in rows]
        assert kinds.count("3D") == 3
        assert kinds.count("TimeSeries") == 12
        assert {"TextDocument", "TextLog"} < set(kinds)
    assert len(rrd.reader.blueprints()) == 2
    # The scene was made in Python.
    assert UNSAID in rrd.static("scene", "TextDocument:text")[0]
    about = rrd.static("about", "TextDocument:text")[0]
    assert "| method | rk4 |" in about
    assert "| steps | " in about
    assert "thinned" not in about
    assert rrd.static("__properties/run", "method") == ["rk4"]
    assert int(rrd.static("__properties/run", "steps")[0]) >= 600


def test_series_have_names_and_colors(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path)
    assert rrd.static("angular_momentum", "SeriesLines:names") == ["x", "y", "z"]
    assert len(set(rrd.static("angular_momentum", "SeriesLines:colors"))) == 3
    assert rrd.static("force/wrench/body", "SeriesLines:names")[0] == "wrench x (body)"
    falling = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"
        "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n"
    )
    rrd, _ = logged(tmp_path, falling, ())
    assert rrd.static("energy/potential", "SeriesLines:names") == ["potential energy"]


def test_warnings_are_logged_and_good_health_is_not(tmp_path: Path) -> None:
    events = [
        still(0),
        Status(0, 0, "fine", {}),
        Status(500_000, 1, "command rejected", {"frame_id": "hand"}),
        still(1),
        Status(1_000_000, 2, "broken", {}),
    ]
    rrd = written(tmp_path / "a.rrd", events)
    assert rrd.values("log", "TextLog:text").ravel().tolist() == ["command rejected (frame_id: hand)", "broken"]
    assert rrd.values("log", "TextLog:level").ravel().tolist() == ["WARN", "ERROR"]
    assert rrd.times("log", "TextLog:text") == [500_000, 1_000_000]


def test_far_from_the_origin_the_picture_is_recentred_and_the_numbers_are_not(tmp_path: Path) -> None:
    start = (7.0e6, -2.0e6, 1.0e6)
    rrd, samples = logged(tmp_path, replace(SCENE, initial=replace(SCENE.initial, position_world=start)))
    drawn = rrd.values("world/body", "Transform3D:translation")[:, 0]
    moved = np.array([sample.position_world for sample in samples]) - np.array(start)
    np.testing.assert_allclose(drawn, moved, rtol=0, atol=1e-6)
    assert rrd.values("position")[-1].tolist() == list(samples[-1].position_world)
    assert str(list(start)) in rrd.static("about", "TextDocument:text")[0]


def test_commands_and_rejections_are_told_and_marked(tmp_path: Path) -> None:
    late = Wrench((math.nan, 0.0, 0.0), ZERO, "body", 1_500_000_000)
    rrd, samples = logged(tmp_path, commands=(*COMMANDS, ("wrench", late)))
    lines = rrd.values("log", "TextLog:text").ravel().tolist()
    assert lines[0] == "wrench: force (1, 0, 0) N, torque (0, 0, 0.5) N m, in body axes"
    *told, last = lines
    assert [line.split(":")[1].split("(")[0].strip() for line in told] == ["force", "force", "rejected", "force"]
    assert last.startswith("1 command was rejected and had no effect: wrench at simulation time 1.5")
    assert rrd.values("log", "TextLog:level").ravel().tolist() == ["INFO", "INFO", "WARN", "INFO", "WARN"]
    assert rrd.times("energy/commands") == [505_000_000, 1_000_000_000, 2_000_000_000]
    marked = rrd.values("world/path/commands", "Points3D:positions")[:, 0]
    for place, sample in zip(marked, (samples[50], samples[100], samples[200]), strict=True):
        arm = rotation.rotate(sample.orientation_xyzw, BODY.center_of_mass)
        np.testing.assert_allclose(place, np.add(sample.position_world, arm), rtol=0, atol=5e-7)


def test_of_very_many_commands_few_are_marked(tmp_path: Path) -> None:
    events: list[Event] = [still(0)]
    events += [AppliedWrench(i, "wrench", None, "world", (float(i), 0.0, 0.0), ZERO) for i in range(1, 5001)]
    rrd = written(tmp_path / "a.rrd", [*events, still(1)])
    times = np.array(rrd.times("energy/commands"))
    assert 24 <= len(times) <= 48
    # Evenly among all, to the last.
    assert len(np.unique(np.diff(times))) == 1
    assert times[-1] > 4800


def test_defects_are_plotted_in_units_that_their_labels_can_show(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path)
    for entity in ("energy/defect", "angular_momentum/defect", "linear_momentum/defect"):
        (name, *_) = rrd.static(f"{entity}/scaled", "SeriesLines:names")
        exponent = int(name.split("[1e")[1].rstrip("]"))
        scaled, told = rrd.values(f"{entity}/scaled"), rrd.values(entity)
        np.testing.assert_allclose(scaled * 10.0**exponent, told, rtol=1e-15)
        assert -16 <= exponent < -4
        assert np.abs(scaled).max() < 1e4


@pytest.mark.parametrize(("speed", "shown"), [(0.5, True), (7600.0, False)])
def test_a_path_of_kilometres_is_not_drawn_beside_a_body_of_metres(tmp_path: Path, speed: float, shown: bool) -> None:
    scene = replace(SCENE, initial=replace(SCENE.initial, linear_velocity_world=(speed, 0.0, 0.0)))
    rrd, _ = logged(tmp_path, scene, commands=())
    said: list[str] = []
    for store in rrd.reader.blueprints():
        for chunk in rrd.reader.stream(store=store).to_chunks():
            batch = chunk.to_record_batch()
            columns = [name for name in batch.schema.names if name == "ViewContents:query"]
            said += [str(batch.column(name).to_pylist()) for name in columns]
    assert any("/world/**" in text for text in said)
    assert any("- /world/path/**" in text for text in said) == (not shown)


def test_the_views_have_frames_of_the_size_of_what_they_show(tmp_path: Path) -> None:
    rrd, _ = logged(tmp_path)
    size = equivalent_box(BODY)[1]
    assert rrd.static("world/center_of_mass/view", "Transform3D:scale")[0] == pytest.approx([size] * 3, rel=1e-6)
    path = np.array(rrd.static("world/path/center_of_mass", "LineStrips3D:strips")[0])
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    assert rrd.static("world/view", "Transform3D:translation")[0] == pytest.approx(middle.tolist(), rel=1e-5)
    extent = float(np.linalg.norm(np.ptp(path, axis=0)))
    assert rrd.static("world/view", "Transform3D:scale")[0][0] == pytest.approx(max(size, 0.25 * extent), rel=1e-5)


def test_thinning_is_even_where_the_length_is_known(tmp_path: Path) -> None:
    scene = replace(SCENE, duration=10.0, output_rate=1000.0)
    rrd = written(tmp_path / "a.rrd", [still(i) for i in range(10_001)], scene, max_rows=1000, batch_rows=128)
    assert rrd.indices("position") == list(range(0, 10_001, 10))
    np.testing.assert_array_equal(rrd.values("position")[:, 0], range(0, 10_001, 10))
    assert "thinned" in rrd.static("about", "TextDocument:text")[0]


def test_a_run_without_end_grows_with_its_logarithm_and_keeps_its_last_sample(tmp_path: Path) -> None:
    scene = replace(SCENE, duration=None)
    rrd = written(tmp_path / "a.rrd", [still(i) for i in range(10_000)], scene, max_rows=100, batch_rows=32)
    indices = rrd.indices("position")
    assert indices[:101] == [*range(100), 100]
    assert indices[-1] == 9_999
    assert len(indices) <= 100 * (math.log2(10_000 / 100) + 1) + 1
    assert np.all(np.diff(np.diff(indices[:-1])) >= 0)
    assert rrd.values("position")[-1, 0] == 9_999.0


def test_many_commands_are_thinned_but_what_is_held_at_a_kept_sample_is_right(tmp_path: Path) -> None:
    events: list[Event] = []
    for i in range(200):
        events.append(still(i))
        for j in range(5):
            force = (float(5 * i + j), 0.0, 0.0)
            events.append(AppliedWrench(i * 1_000_000 + 100 * j, "wrench", None, "world", force, ZERO))
    rrd = written(tmp_path / "a.rrd", events, replace(SCENE, duration=None), max_rows=50, batch_rows=16)
    held = dict(zip(rrd.times("force/wrench/world"), rrd.values("force/wrench/world")[:, 0].tolist(), strict=True))
    assert len(held) < 400
    for index in rrd.indices("position")[60:]:
        before = max(time for time in held if time < index * 1_000_000)
        assert held[before] == 5.0 * index - 1.0
    assert rrd.values("force/wrench/world")[-1, 0] == 999.0


def test_the_path_stays_small_and_ends_at_the_body(tmp_path: Path) -> None:
    rrd = written(tmp_path / "a.rrd", [still(i) for i in range(40_000)], replace(SCENE, duration=None))
    strip = rrd.static("world/path/center_of_mass", "LineStrips3D:strips")[0]
    assert 8192 <= len(strip) <= 2 * 8192 + 2
    assert strip[-1][0] == pytest.approx(39_999.0 + BODY.center_of_mass[0], rel=1e-6)
    assert np.ptp(np.diff([point[0] for point in strip[:-1]])) < 0.1


def test_the_recording_follows_a_run_of_few_rows(tmp_path: Path) -> None:
    sink, path = RerunSink(tmp_path / "a.rrd", follow_s=0.0), tmp_path / "a.rrd"
    sink.open(RunInfo(SCENE, "rk4"))
    sizes = []
    for index in range(5):
        sink.write(still(index))
        sizes.append(path.stat().st_size)
    sink.close({})
    assert len(set(sizes)) > 2
    assert Rrd(path).indices("position") == [*range(5)]


def test_two_runs_of_one_process_stay_two_recordings(tmp_path: Path) -> None:
    ids = {written(tmp_path / f"{i}.rrd", [still(0)]).reader.recordings()[0].recording_id for i in range(2)}
    assert len(ids) == 2


def test_of_two_that_write_one_file_at_once_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    sinks = [RerunSink(path) for _ in range(2)]
    for sink in sinks:
        sink.open(RunInfo(SCENE, "rk4"))
    for sink, rows in zip(sinks, (500, 400), strict=True):
        for index in range(rows):
            sink.write(still(index))
        sink.close({})
    rrd = Rrd(path)
    assert len(rrd.reader.recordings()) == 1
    assert rrd.indices("position") == [*range(400)]


def test_closing_again_or_without_a_run_is_harmless(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "run.rrd"
    sink = RerunSink(path)
    sink.close({})
    assert not path.parent.exists()
    sink.open(RunInfo(SCENE, "rk4"))
    sink.close({"steps": "0"})
    size = path.stat().st_size
    sink.close({"steps": "1"})
    assert path.stat().st_size == size
    assert "| steps | 0 |" in Rrd(path).static("about", "TextDocument:text")[0]
    with pytest.raises(RuntimeError, match=r"run\.rrd"):
        sink.write(still(0))


@pytest.mark.parametrize("name", [".", "file/run.rrd"])
def test_a_path_that_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("in the way")
    path = tmp_path / name
    with pytest.raises(LogError) as caught:
        RerunSink(path).open(RunInfo(SCENE, "rk4"))
    assert str(path) in str(caught.value)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_an_error_not_a_short_file() -> None:
    with pytest.raises(LogError, match="/dev/full"):
        RerunSink("/dev/full").open(RunInfo(SCENE, "rk4"))


@pytest.mark.parametrize("times", range(5))
def test_a_disk_that_fills_up_is_an_error_and_nothing_waits(tmp_path: Path, times: int) -> None:
    """Rerun's own writer ends without an answer to who waits for it, mostly: the process could only be killed."""
    resource = pytest.importorskip("resource")
    path, (soft, hard) = tmp_path / "run.rrd", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, hard))
    try:
        with pytest.raises(LogError, match=rf"run\.rrd: .*{os.strerror(errno.EFBIG)}"):
            simulate(replace(SCENE, duration=100.0), sinks=[RerunSink(path, batch_rows=50)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.stat().st_size == 400_000


def test_rerun_switched_off_is_an_error_not_an_empty_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(LogError, match="environment variable RERUN"):
        RerunSink(tmp_path / "run.rrd").open(RunInfo(SCENE, "rk4"))


def test_without_the_package_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match="extra 'log'"):
        RerunSink(tmp_path / "run.rrd").open(RunInfo(SCENE, "rk4"))
    assert not (tmp_path / "run.rrd").exists()


def test_a_viewer_that_cannot_be_started_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr("rb_dynamics.sinks.rerun_sink._PORT", port)
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(LogError, match="expected a display"):
        simulate(parse_scene("body: {mass: 1}\nduration: 1\n"), sinks=[RerunSink("spawn")])
    assert list(tmp_path.iterdir()) == []


def test_a_viewer_that_takes_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rb_dynamics.sinks.rerun_sink._VIEWER_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"rerun+http://127.0.0.1:{silent.getsockname()[1]}/proxy"
        with pytest.raises(LogError, match=re.escape(f"viewer at {address} received nothing for 0.5 s")):
            simulate(parse_scene("body: {mass: 1}\nduration: 1\n"), sinks=[RerunSink(address)])


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not tell whether bytes move")
def test_a_viewer_that_is_slow_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """And looking at the connections leaves none open."""
    monkeypatch.setattr("rb_dynamics.sinks.rerun_sink._VIEWER_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as slow:
        address = f"rerun+http://127.0.0.1:{slow.getsockname()[1]}/proxy"
        before = len(os.listdir("/dev/fd"))
        with socket.create_connection(slow.getsockname(), 30.0) as connection, slow.accept()[0] as viewer:
            with sending_to(address):
                for _ in range(8):
                    connection.sendall(b"rows")
                    assert viewer.recv(4) == b"rows"
                    time.sleep(0.05)
            with pytest.raises(LogError, match="received nothing"), sending_to(address):
                assert connection.recv(1) == b""
        assert len(os.listdir("/dev/fd")) == before


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("rerun+http://127.0.0.1:1/proxy", "cannot reach a Rerun viewer at rerun.http://127.0.0.1:1/proxy"),
        ("rerun+http://127.0.0.1:9876", "expected a file, spawn or the address of a viewer"),
        ("http://127.0.0.1:9876/proxy", "expected a file, spawn or the address of a viewer"),
        ("tcp://host/run.rrd", "write it as in rerun.http://127.0.0.1:9876/proxy"),
    ],
)
def test_an_address_is_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str, says: str) -> None:
    monkeypatch.chdir(tmp_path)
    scene = parse_scene("body: {mass: 1}\nduration: 1\n")
    with pytest.raises(LogError, match=says):
        simulate(scene, sinks=[RerunSink(target)])
    assert list(tmp_path.iterdir()) == []


def test_wheels_and_what_sensors_gave_stand_beside_the_truth(tmp_path: Path) -> None:
    scene = parse_scene("""
body:
  mass: 10
  inertia: {diagonal: [0.05, 0.12, 0.14]}
  frames: {mount: {position: [0, 0, 0], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}}
initial: {angular_velocity_body: [0.1, -0.2, 2.0]}
wrenches: []
actuators:
  - {type: reaction_wheel, name: spin, axis: [1, 0, 0], inertia: 1.0e-4, command: torque, max_torque: 5.0e-3,
     max_speed: 600.0, speed: 100.0}
sensors:
  - {type: imu, name: imu, frame: mount, rate: 20.0, delay: 0.01}
  - {type: star_tracker, name: tracker, frame: mount, rate: 5.0}
duration: 4
output_rate: 20
""")
    rrd, samples = logged(tmp_path, scene, commands=())
    np.testing.assert_array_equal(rrd.values("wheels"), [sample.wheel_speeds for sample in samples])
    assert rrd.static("wheels", "SeriesLines:names") == ["spin (at most 600 rad/s)"]
    gyro, tracker = rrd.values("measured/imu/angular_velocity"), rrd.values("measured/tracker/orientation_xyzw")
    # Without errors; a message comes 10 ms after its sample, the last one after the end.
    assert rrd.times("measured/imu/angular_velocity") == [sample.time_ns for sample in samples][: len(gyro)]
    np.testing.assert_allclose(gyro, rrd.values("angular_velocity")[: len(gyro)], rtol=0, atol=1e-14)
    # Of q and -q the one beside the line, though the body turns by more than a whole turn.
    np.testing.assert_allclose(tracker, rrd.values("attitude")[::4][: len(tracker)], rtol=0, atol=1e-14)
    assert ("/measured/imu/specific_force", "Scalars:scalars") in rrd.rows
