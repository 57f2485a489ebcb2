"""The commands as a user types them, in a process of their own where it matters."""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from command_line import command

from rb_dynamics import Sample, Simulation, Wrench, WrenchError, read_scene
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink

FREE = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.1, 2, 0.1]}\nduration: 3\n"

# Keys of scenes whose effects have a potential, and of those with reaction wheels.
OF_SOME_SCENES = {"potential_energy", "wheel_speeds", "motor_work", "friction_heat"}


def process(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rb_dynamics", *map(str, arguments)],
        capture_output=True,
        text=True,
        env=os.environ,
        check=False,
    )


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(FREE)
    return path


@pytest.mark.ros
def test_demo_flies_as_the_recorded_body_did(tmp_path: Path, scene_dir: Path, example_dir: Path) -> None:
    pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")
    demo = process("demo", "--out", tmp_path / "out")
    assert demo.returncode == 0, demo.stdout + demo.stderr
    assert "600 stamps compared with the recording: all within 1e-10" in demo.stdout
    assert "the same bits" in demo.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"demo.mcap", "demo.rrd", "demo.html", "flip.rrd"}
    assert "Comparison with the recording" in (tmp_path / "out" / "demo.html").read_text()

    # Read by a reader that is not ours: the log holds what the recorded body did, and the bits of an offline run.
    def poses(path: Path, topic: str) -> dict[int, list[float]]:
        highlevel = pytest.importorskip("rosbags.highlevel", reason="extra 'log' is not installed")
        with highlevel.AnyReader([path]) as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            found = {}
            for connection, time_ns, raw in reader.messages(connections):
                pose = reader.deserialize(raw, connection.msgtype).pose
                p, q = pose.position, pose.orientation
                found[time_ns] = [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
            return found

    flown = poses(tmp_path / "out" / "demo.mcap", "/pose")
    truth = poses(example_dir / "slew.mcap", "/truth/pose")
    assert len(flown) == 6001
    assert max(np.abs(np.subtract(flown[t], truth[t])).max() for t in truth) < 1e-12

    offline = command(
        "simulate",
        scene_dir / "slew.yaml",
        "--wrench",
        example_dir / "slew.mcap",
        "--mcap",
        tmp_path / "s.mcap",
        "--json",
    )
    result = json.loads(offline.stdout)
    assert result["position_world"] + result["orientation_xyzw"] == flown[60_000_000_000]
    results = [
        read_bag(p).metadata["rb_dynamics.result"] for p in (tmp_path / "out" / "demo.mcap", tmp_path / "s.mcap")
    ]
    assert results[0]["states_sha256"] == results[1]["states_sha256"]
    assert results[0]["inputs_sha256"] == results[1]["inputs_sha256"]


def test_json_has_the_promised_keys_in_full_precision(scene: Path) -> None:
    result = json.loads(command("simulate", scene, "--method", "rk4", "--step", "0.01", "--json").stdout)
    always = {field.name for field in fields(Sample)} - OF_SOME_SCENES
    assert set(result) == always | {"method", "steps", "wall_time_s"}
    assert (result["time_ns"], result["method"], result["steps"]) == (3_000_000_000, "rk4", 300)
    run = Simulation(read_scene(scene, {"solver.method": "rk4", "solver.step": 0.01}))
    run.advance(3_000_000_000)
    assert tuple(result["orientation_xyzw"]) == run.sample.orientation_xyzw


def test_text_says_state_and_defects(scene: Path) -> None:
    text = command("simulate", scene, "--duration", "0.5").stdout
    assert "after 0.5 s: 1 step of exact" in text
    assert "energy_defect" in text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["SCENE", "--method", "rk5"], "rk4"),
        (["SCENE", "--step", "0", "--method", "rk4"], "step"),
        (["SCENE", "--duration", "-1"], "duration"),
        (["SCENE", "--wrench", "SCENE"], "MCAP"),
        (["SCENE", "--step", "0.1", "--accuracy", "1e-3"], "not allowed with"),
        (["SCENE", "--ros-args", "-p", "a:=1"], "belongs to the commands node"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(scene: Path, arguments: list[str], says: str) -> None:
    result = command("simulate", *[str(scene) if a == "SCENE" else a for a in arguments])
    assert result.returncode == 2
    assert says in result.stderr
    assert result.stdout == ""


def test_a_file_that_is_not_there_is_one_message_and_exit_code_2() -> None:
    result = process("simulate", "nowhere.yaml")
    assert result.returncode == 2
    assert "nowhere.yaml" in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


def test_a_command_that_cannot_be_honoured_is_named_and_left_out(scene: Path, tmp_path: Path) -> None:
    bag = tmp_path / "commands.mcap"
    run = Simulation(read_scene(scene), [McapSink(bag)])
    for time_ns, force in ((0, 1.0), (1_000_000_000, math.nan), (2_000_000_000, 0.0)):
        with pytest.raises(WrenchError, match="finite") if math.isnan(force) else contextlib.nullcontext():
            run.post("wrench", Wrench((force, 0.0, 0.0), frame_id="world", stamp_ns=time_ns), time_ns)
    run.start()
    run.advance(3_000_000_000)
    run.finish()
    result = command("simulate", scene, "--wrench", bag, "--json")
    assert result.returncode == 0
    assert "1 of 3 commands" in result.stderr
    assert json.loads(result.stdout)["linear_momentum_world"] == [2.0, 0.0, 0.0]


def test_body_shows_principal_axes_and_warns(scene: Path) -> None:
    text = process("body", scene).stdout
    assert "principal" in text
    assert "middle principal axis" in text
    assert json.loads(command("body", scene, "--json").stdout)["principal_moments"] == [1.0, 2.0, 3.0]


def test_help_names_every_command() -> None:
    text = process("--help").stdout
    assert all(name in text for name in ("simulate", "node", "inspect", "body", "demo"))


def test_a_pipe_gets_no_progress_bar(scene: Path) -> None:
    said = process("simulate", scene).stderr.splitlines()
    assert [line for line in said if not line.startswith("note: no commands on ")] == []


@pytest.mark.parametrize("bound", [1e-9, 10.0])
def test_the_verdict_stands_when_nobody_reads_on(scene: Path, tmp_path: Path, bound: float) -> None:
    """As of `compare ... | head -1`: a check that had failed ended with 0."""
    logs = [str(tmp_path / f"{mass}.mcap") for mass in (2, 3)]
    for mass, log in zip((2, 3), logs, strict=True):
        command("simulate", scene, "--set", f"initial.angular_velocity_body=[0, 0, {mass}]", "--mcap", log)
    read, write = os.pipe()
    os.close(read)
    line = [sys.executable, "-m", "rb_dynamics", "compare", *logs, "--bound", str(bound)]
    try:
        ended = subprocess.run(line, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(write)
    assert (ended.returncode, ended.stderr) == (int(bound < 1.0), "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("arguments", ["simulate SCENE", "simulate SCENE --json", "--version", "simulate --help"])
def test_output_that_finds_no_room_is_an_error(scene: Path, arguments: str, unbuffered: str) -> None:
    """It was a traceback and the exit code of a check that failed; of `--help`, without a buffer, no error at all."""
    line = [sys.executable, "-m", "rb_dynamics", *arguments.replace("SCENE", str(scene)).split()]
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment)
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1].startswith("rb-dynamics: cannot print the output: No space left on device; ")


def test_a_command_without_output_runs(scene: Path, tmp_path: Path) -> None:
    """As a daemon may start it."""
    line = [sys.executable, "-m", "rb_dynamics", "simulate", str(scene), "--mcap", str(tmp_path / "run.mcap")]
    ended = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *line], stderr=subprocess.PIPE, text=True, check=False)
    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False)
    assert command("replay", tmp_path / "run.mcap").returncode == 0


class TestSet:
    """`--set` works for every key, also for those with an option of their own."""

    def test_any_key(self, scene: Path) -> None:
        result = command(
            "simulate", scene, "--json", "--set", "duration=0.5", "--set", "solver={method: rk4, step: 0.1}",
            "--set", "body.mass=2e0",
        )  # fmt: skip
        found = json.loads(result.stdout)
        assert (found["time_ns"], found["method"], found["steps"]) == (500_000_000, "rk4", 5)

    def test_an_option_of_its_own_wins(self, scene: Path) -> None:
        result = command("simulate", scene, "--json", "--set", "duration=0.5", "--duration", "0.25")
        assert json.loads(result.stdout)["time_ns"] == 250_000_000

    @pytest.mark.parametrize(
        ("text", "says"),
        [("duration", "expected KEY=VALUE"), ("body.mass=", "expected KEY=VALUE"), ("duration=abc", "duration"),
         ("body.mass=[", "valid YAML"), ("nonsense=1", "nonsense"),
         ("body.inertia={diagonal: [1, 1, 1], diagonal: [2, 2, 2]}", "diagonal: found again"),
         ("body.mass=2\nduration: 3", "duration: found another key")],
    )  # fmt: skip
    def test_nonsense_is_answered(self, scene: Path, text: str, says: str) -> None:
        result = command("simulate", scene, "--set", text)
        assert result.returncode == 2
        assert says in result.stderr


def test_a_scene_that_waits_for_commands_says_that_none_came() -> None:
    root = Path(__file__).parents[2]
    result = command("simulate", root / "config" / "slew.yaml", "--duration", "0.1")
    assert "no commands on wrench/body, wrench/world" in result.stderr


def test_version_is_said() -> None:
    assert process("--version").stdout.startswith("rb-dynamics ")
