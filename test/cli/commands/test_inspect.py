"""The command `inspect`: output, files, exit codes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rb_dynamics.cli import main
from rb_dynamics.report import html, interactive_plots
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene import parse_scene
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = """
body: {mass: 1.0, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.1, 2, 0.1]}
wrenches: []
solver: {method: rkmk4, step: 0.002}
duration: 1.0
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    simulate(parse_scene(SCENE, "spin.yaml"), (), [McapSink(path)])
    return path


def test_own_run(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(log)]) == 0
    out, err = capsys.readouterr()
    # The name of the folder decides where lines break.
    words = " ".join(out.split())
    assert "scene spin.yaml" in words
    assert "101 samples" in words
    assert out.endswith("checks passed\n")
    assert max(map(len, out.splitlines())) <= 100
    assert err == ""


def test_recording_without_scene_says_what_is_missing(example_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(example_dir / "slew.mcap")]) == 0
    out = capsys.readouterr().out
    assert "angular momentum" not in out
    assert "--scene SCENE" in out


def test_recording_with_scene(example_dir: Path, scene_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(example_dir / "slew.mcap"), "--scene", str(scene_dir / "slew.yaml")]) == 0
    out = capsys.readouterr().out
    assert "linear momentum balance" in out
    assert "angular momentum balance" in out


def test_a_scene_for_a_log_of_our_own_is_not_used_and_that_is_said(
    log: Path, scene_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def checks(out: str) -> list[str]:
        return [line for line in out.splitlines() if line.startswith(("ok  ", "FAIL"))]

    assert main(["inspect", str(log)]) == 0
    alone = capsys.readouterr().out
    assert main(["inspect", str(log), "--scene", str(scene_dir / "slew.yaml")]) == 0
    out = capsys.readouterr().out
    assert "The scene given is not used" in out
    assert checks(out) == checks(alone)


@pytest.mark.parametrize("script", ["", "plotly.js"])
def test_html(
    script: str, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (html, interactive_plots):
        monkeypatch.setattr(module, "library", lambda: script)
    assert main(["inspect", str(log), "--html", str(tmp_path / "out" / "run.html")]) == 0
    assert (tmp_path / "out" / "run.html").read_text().startswith("<!DOCTYPE html>")
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith(f"wrote {tmp_path / 'out' / 'run.html'}")
    assert ("its figures are pictures: pip install 'rb_dynamics[interactive]'" in said) == (not script)


def test_cut_off_run_exits_with_1_and_says_so(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_bytes(log.read_bytes()[:-3000])
    assert main(["inspect", str(log)]) == 1
    out = capsys.readouterr().out
    assert "FAIL  file is whole: cut off" in out
    # Only the index is gone.
    assert "ok    recording has all its parts" in out
    assert "1 of " in out.splitlines()[-1]


def test_defect_beyond_the_bound_exits_with_1(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(log), "--bound", "1e-18"]) == 1
    assert "FAIL  energy balance: worst" in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"not a log", b"\x89MCAP0\r\n" + b"\xff" * 100])
def test_junk_exits_with_2_and_one_message(content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(content)
    assert main(["inspect", str(junk)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("rb-dynamics: ")
    assert str(junk) in err
    assert "Traceback" not in err


def test_missing_file_exits_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(tmp_path / "none.mcap")]) == 2
    assert "none.mcap" in capsys.readouterr().err


@pytest.mark.parametrize("bound", ["0", "-1", "nan", "x"])
def test_bound_must_be_positive(bound: str, log: Path) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["inspect", str(log), f"--bound={bound}"])


def test_output_that_cannot_show_every_letter(log: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rb_dynamics", "inspect", str(log)],
        env={"PYTHONIOENCODING": "ascii", "PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"kg m\\xb2/s" in done.stdout
