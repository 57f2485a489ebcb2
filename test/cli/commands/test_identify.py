"""The command `identify`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rb_dynamics import Simulation, parse_scene, read_scene
from rb_dynamics.cli import main

TUMBLE = """
body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}
initial: {angular_velocity_body: [0.3, 2, 0.5]}
duration: 2
output_rate: 50
"""
KEYS = {"parameters", "mass", "center_of_mass", "inertia", "principal_moments", "residuals", "unknown_combinations",
        "starts", "converged"}  # fmt: skip


@pytest.fixture(scope="module")
def tumble(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("tumble")
    scene, log = folder / "tumble.yaml", folder / "tumble.mcap"
    scene.write_text(TUMBLE, encoding="utf-8")
    assert main(["simulate", str(scene), "--mcap", str(log), "--json"]) == 0
    return scene, log


def test_ratios_of_a_tumble_are_found_and_written(
    tumble: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, log = tumble
    out, page = tmp_path / "fitted.yaml", tmp_path / "fitted.html"
    files = ["--out", str(out), "--html", str(page)]
    wrong = ["--set", "body.inertia={diagonal: [2, 2, 2]}"]
    code = main(["identify", str(scene), str(log), *wrong, "--fit", "inertia_ratios", *files, "--json"])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)

    assert code == 0
    assert "Identified from tumble.mcap" in page.read_text(encoding="utf-8")
    assert set(found) >= KEYS
    assert {"name", "value", "standard_error", "interval", "unit", "known", "adapted"} == set(found["parameters"][0])
    ratios = [each["value"] for each in found["parameters"] if each["name"] == "inertia_ratios.zz"]
    assert ratios == [pytest.approx(2.5 / 5.5, rel=1e-5)]
    assert found["residuals"]["/twist"]["count"] == 101
    assert sorted(read_scene(out).body.principal_moments)[2] == pytest.approx(6.0 * 2.5 / 5.5, rel=1e-5)


def test_the_stamp_at_which_a_written_scene_begins_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where stamps begin within the run, time 0 of the commands is stamp 0 otherwise: they act too late."""
    scene, table, out = (tmp_path / name for name in ("tumble.yaml", "gyro.csv", "fitted.yaml"))
    scene.write_text(TUMBLE, encoding="utf-8")
    run, rows = Simulation(parse_scene(TUMBLE)), []
    for k in range(101):
        run.advance(k * 20_000_000)
        rows.append(f"{1.25 + 0.02 * k:.2f},{','.join(map(repr, run.sample.angular_velocity_body))}")
    table.write_text("\n".join(["time_s,wx,wy,wz", *rows]), encoding="utf-8")
    given = ["--columns", "gyro=wx,wy,wz", "--fit", "inertia_ratios", "--out", str(out)]
    assert main(["identify", str(scene), str(table), *given]) == 0
    assert f"time 0 is stamp 1.250000000 s of {table}; fly" in capsys.readouterr().out


def test_what_is_asked_for_and_not_told_is_code_1(
    tumble: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    scene, log = tumble
    code = main(["identify", str(scene), str(log), "--fit", "mass", "--advise"])
    printed = capsys.readouterr()

    assert code == 1
    assert "not known from these recordings: mass" in printed.err
    assert "while a known force acts" in printed.out


@pytest.mark.parametrize("option", ["--pose-topic", "--twist-topic", "--wrench-topic"])
def test_a_topic_that_is_not_there_is_code_2(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    root = Path(__file__).parents[3]
    assert main(["identify", str(root / "config/slew.yaml"), str(root / "examples/slew.mcap"), option, "/none"]) == 2
    assert "/none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--fit", "inertias"], "did you mean inertia"),
        (["--fit", "effects[0].rotation"], "it has none"),
        (["--set", "wrenches=[{topic: push, lag: 0.5}]"], "found a lag of push"),
        (["--starts", "0"], "whole number of at least 1"),
        (["--columns", "gyro"], "--columns: found 'gyro', expected QUANTITY=NAMES"),
    ],
)
def test_bad_input_is_one_line_and_code_2(
    tumble: tuple[Path, Path], arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, log = tumble
    try:
        code = main(["identify", str(scene), str(log), *arguments])
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    printed = capsys.readouterr().err

    assert code == 2
    assert expected in printed
    assert printed.count("\n") == 1
