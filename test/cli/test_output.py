"""What commands share to print and write their results."""

from __future__ import annotations

import io
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest
from bag_rows import STAMPED, stamped, write_rows

from rb_dynamics.cli import main, output
from rb_dynamics.cli.output import as_text, warn_rejected
from rb_dynamics.errors import LogError
from rb_dynamics.loads.actuator import Setpoint
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS as SECOND
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.read import parse_scene


def test_a_terminal_that_lacks_a_character_shows_its_escape(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", stream)

    output.show(Namespace(json=False), dict, lambda: "1 ± 2")

    assert stream.buffer.getvalue() == b"1 \\xb1 2\n"


def test_the_name_of_a_file_that_is_no_utf_8_is_shown_escaped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "s.yaml").write_text("body: {mass: 1}\nduration: 1\n")
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    monkeypatch.setattr("sys.stdout", stream)

    assert main(["simulate", str(tmp_path / "s.yaml"), "--mcap", str(tmp_path / "\udcff.mcap")]) == 0

    assert b"\\udcff.mcap" in stream.buffer.getvalue()


def test_folders_are_made_for_files_and_not_for_viewers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    output.prepare(("pages/a.html", "rerun+http://127.0.0.1:9876/proxy", "spawn", None), "scene.yaml", None)

    assert [path.name for path in tmp_path.iterdir()] == ["pages"]


def test_an_input_is_not_written_to(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.touch()
    with pytest.raises(LogError, match=r"run\.mcap"):
        output.prepare([str(log)], str(log))


def test_without_a_terminal_a_line_tells_the_progress_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    times = iter([0.0, 4.0, 11.0, 15.0, 22.0, 40.0])
    monkeypatch.setattr("time.monotonic", lambda: next(times))
    with output.counting("campaign.yaml", "run", 20, 100) as tell:
        for done in (30, 40, 50, 60, 100):
            tell(done, 100)
    assert capsys.readouterr().err.splitlines() == [
        "campaign.yaml: 40 of 100 runs after 11 s, some 33 s left",
        "campaign.yaml: 60 of 100 runs after 22 s, some 22 s left",
    ]


def test_commands_of_a_bag_that_come_too_slowly_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = [("/slow", STAMPED, k * SECOND, stamped(k * SECOND, 0.1)) for k in range(10)]
    quick = [("/quick", STAMPED, k * SECOND // 100, stamped(k * SECOND // 100, 0.1)) for k in range(100)]
    bag, scene = write_rows(tmp_path / "bag.mcap", [*quick, *slow]), tmp_path / "scene.yaml"
    scene.write_text(
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 0, 1.5]}\n"
        "wrenches: [{topic: slow}, {topic: quick}]\nduration: 10\n"
    )

    assert main(["simulate", str(scene), "--wrench", str(bag)]) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if "raise its rate" in line]
    assert len(notes) == 1
    assert notes[0].startswith("note: slow: the body turns by 1.5 rad from one command to the next")


def test_clipped_commands_are_named_and_a_wheel_at_rest_is_at_0(capsys: pytest.CaptureFixture[str]) -> None:
    text = """\
body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.3, 0.2, 0.1]}
duration: 1
wrenches: [{topic: push, max_force: 1.0, on_excess: clip}]
actuators:
  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.1, max_torque: 1.0}
  - {type: reaction_wheel, name: other, axis: [1, 0, 0], inertia: 0.1, max_torque: 1.0, speed: 5.0}
"""
    push, turn = ("push", Wrench((9.0, 0.0, 0.0))), ("wheel/command", Setpoint(5.0))
    run = simulate(parse_scene(text), [push, push, turn])
    warn_rejected(run, 3)
    assert "3 of 3 commands were clipped to the limits of" in (said := capsys.readouterr().err)
    assert said.endswith("actuator: push (2), wheel/command (1)\n")
    sample = replace(run.sample, wheel_speeds=(3.46945e-18, 5.0))
    (line,) = [line for line in as_text(replace(run, sample=sample)).splitlines() if "wheel_speeds" in line]
    assert line.split() == ["wheel_speeds", "0", "5", "rad/s"]
