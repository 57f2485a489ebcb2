"""The example plug-in, installed by pip: its parts are found by name, and docs/extending.md is true."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
SHELL = [
    # 200 000 steps, which the first run takes in plain Python; and what measures for some seconds.
    pytest.param(line, marks=[pytest.mark.slow] * ("--step 1e-4" in line or line.startswith(("explain", "trade"))))
    for line in re.findall(r"^\.venv/bin/rb-dynamics (.*)$", PAGE, re.MULTILINE)
]

Command = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def python(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the interpreter of an environment with this tree, its third parties and the plug-in."""
    home = tmp_path_factory.mktemp("plugin")
    venv.create(home / "env", symlinks=True, with_pip=False)
    (site,) = (home / "env").glob("lib/python*/site-packages")
    (site / "paths.pth").write_text(f"{root}\n{sysconfig.get_path('purelib')}\n", encoding="utf-8")
    shutil.copytree(root / "examples" / "plugin", home / "source")
    python = home / "env" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    options = ["--no-deps", "--no-index", "--no-build-isolation", str(home / "source")]
    subprocess.run([*pip, *options], check=True, capture_output=True, text=True)
    return python


@pytest.fixture
def command(python: Path, root: Path, bare_environment: dict[str, str]) -> Command:
    """Return what runs the command line there on the scene of the plug-in."""

    def run(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        line = [str(python), "-m", "rb_dynamics", name, str(root / "examples/plugin/scene.yaml"), *arguments]
        return subprocess.run(line, env=bare_environment, capture_output=True, text=True, check=False)

    return run


def result(command: Command, *arguments: str) -> dict[str, Any]:
    done = command("simulate", "--json", *arguments)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_scene_and_command_line_know_what_the_plugin_brings(command: Command, tmp_path: Path) -> None:
    found = result(command, "--sink", f"lines={tmp_path / 'run.txt'}", "--mcap", str(tmp_path / "run.mcap"))

    assert found["method"] == "heun"
    title, *lines = (tmp_path / "run.txt").read_text().splitlines()
    assert title.endswith("scene.yaml, heun")
    assert [line.split()[0] for line in lines] == ["0", "1", "2", "3", "4", "5"]
    # A log says what it takes to run it again.
    assert b"rb-dynamics-example 0.1.0" in (tmp_path / "run.mcap").read_bytes()
    (x, y, z), t, w = found["position_world"], 5.0, math.sqrt(8.0 / 2.0)
    assert (x, y, z) == pytest.approx((math.cos(w * t), 0.5 / w * math.sin(w * t), 1 - math.cos(w * t)), abs=1e-5)
    assert found["energy_defect"] == pytest.approx(0.0, abs=1e-4)


def test_heun_has_order_two(command: Command) -> None:
    truth = result(command, "--method", "dop853", "--accuracy", "1e-12")
    coarse, fine = (result(command, "--step", step) for step in ("0.01", "0.005"))

    for name in ("position_world", "orientation_xyzw", "angular_velocity_body"):
        ratio = math.dist(coarse[name], truth[name]) / math.dist(fine[name], truth[name])
        assert math.log2(ratio) == pytest.approx(2.0, abs=0.1), name


def test_names_of_plugins_are_offered(command: Command) -> None:
    effect = command("simulate", "--set", "effects[0].type=sprung")
    method = command("simulate", "--method", "heum")
    sink = command("simulate", "--sink", "rows=here.txt")

    assert "did you mean spring?" in effect.stderr
    assert "did you mean heun?" in method.stderr
    assert "expected one of mcap, bag, rerun, lines" in sink.stderr
    assert {done.returncode for done in (effect, method, sink)} == {2}


def test_values_of_the_effect_are_checked_with_their_line(command: Command) -> None:
    done = command("explain", "--set", "effects[0].stiffness=-1")

    assert "effects[0].stiffness: found -1.0, expected a number greater than 0 (N/m); write" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("'stiff'", "TypeError: spring: stiffness is 'stiff', expected a number greater than 0 (N/m)"),
        ("-1.0", "SceneError: spring: stiffness is -1.0, expected a number greater than 0 (N/m)"),
        ("8.0, (1.0, 2.0)", "SceneError: spring: anchor_world is (1.0, 2.0), expected a point (m)"),
    ],
)
def test_arguments_of_the_effect_are_checked_in_python(
    python: Path, folder: Path, arguments: str, message: str
) -> None:
    code = f"from rb_dynamics_example.spring import Spring; Spring({arguments})"
    assert message in in_folder(python, folder, "-c", code).stderr


def test_the_reference_of_this_package_leaves_it_out(python: Path, root: Path) -> None:
    code = "import make_reference; print(make_reference.scene_page())"
    done = in_folder(python, root / "tools", "-c", code)
    assert done.returncode == 0, done.stderr
    assert ", euler | `auto`" in done.stdout
    assert "heun" not in done.stdout


@pytest.fixture(scope="module")
def folder(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder like the source tree, in which the commands of the page may leave their files."""
    folder = tmp_path_factory.mktemp("extending")
    for name in ("config", "examples"):
        (folder / name).symlink_to(root / name)
    return folder


def in_folder(python: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    inherited = ("PYTHONPATH", "LD_LIBRARY_PATH")
    env = {name: value for name, value in os.environ.items() if name not in inherited}
    return subprocess.run([str(python), *arguments], cwd=folder, env=env, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("line", SHELL)
def test_command_of_the_page(line: str, python: Path, folder: Path) -> None:
    line, _, said = line.partition("  # exit code ")
    done = in_folder(python, folder, "-m", "rb_dynamics", *shlex.split(line))

    assert done.returncode == int(said or 0), done.stderr
    # What the page shows of it is what it says, and writes.
    assert not said or f"```\n{done.stderr}```" in PAGE
    if "--sink lines=out/run.txt" in line:
        head = "".join((folder / "out" / "run.txt").read_text().splitlines(keepends=True)[:3])
        assert f"```\n{head}```" in PAGE


@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
def test_python_of_the_page(code: str, python: Path, folder: Path) -> None:
    done = in_folder(python, folder, "-c", code)
    assert done.returncode == 0, done.stderr
