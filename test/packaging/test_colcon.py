"""The tree builds with colcon as an ament_python package, and its node starts from the sourced workspace."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from rb_dynamics.logs.bag_reader import read_bag

if TYPE_CHECKING:
    from pathlib import Path

pytest.importorskip("colcon_ros", reason="extra 'test' is not installed")
from catkin_pkg.package import parse_package


def test_the_manifest_is_one_that_can_be_released(source: Path) -> None:
    warnings: list[str] = []

    package = parse_package(str(source / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)

    assert warnings == []
    assert package.get_build_type() == "ament_python"
    assert (source / package.licenses[0].file).is_file()


@pytest.fixture(scope="module")
def workspace(source: Path) -> Path:
    """Return a workspace in which colcon has built the package."""
    root = source.parent.parent
    command = [sys.executable, "-m", "colcon", "--log-base", "log", "build", "--executor", "sequential"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return root


def _sourced(workspace: Path, command: str, environment: dict[str, str]) -> str:
    done = subprocess.run(
        ["/bin/sh", "-c", f". install/setup.sh && {command}"],
        cwd=workspace,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_import_comes_from_the_workspace(workspace: Path, bare_environment: dict[str, str]) -> None:
    code = "import rb_dynamics; print(rb_dynamics.__file__)"

    printed = _sourced(workspace, f"cd / && '{sys.executable}' -c '{code}'", bare_environment)

    assert printed.startswith(str(workspace / "install" / "rb_dynamics"))


@pytest.mark.ros
def test_node_starts(workspace: Path, bare_environment: dict[str, str]) -> None:
    node = "install/rb_dynamics/lib/rb_dynamics/rigid_body"
    assert "scene" in _sourced(workspace, f"{node} --help", bare_environment)

    scene = "install/rb_dynamics/share/rb_dynamics/config/dzhanibekov.yaml"
    parameters = "-p real_time_factor:=0 -p duration:=2.0 -p mcap:=flown.mcap"
    _sourced(workspace, f"{node} --ros-args -p scene:={scene} {parameters}", bare_environment)
    assert int(read_bag(workspace / "flown.mcap").metadata["rb_dynamics.result"]["end_time_ns"]) == 2_000_000_000


def test_ros2_run_finds_the_node_and_the_examples(workspace: Path, bare_environment: dict[str, str]) -> None:
    folder = workspace / "install" / "rb_dynamics" / "lib" / "rb_dynamics"
    for name in ("rigid_body", "bodies", "lifecycle", "regulate", "command", "control"):
        assert (folder / name).is_file()
    assert "usage: control" in _sourced(workspace, f"{folder}/control --help", bare_environment)


def test_workspace_shares_scenes_launch_file_and_index(workspace: Path, source: Path) -> None:
    share = workspace / "install" / "rb_dynamics" / "share"

    assert (share / "ament_index" / "resource_index" / "packages" / "rb_dynamics").is_file()
    for name in ("config", "examples", "launch"):
        expected = {path.relative_to(source) for path in (source / name).rglob("*") if path.is_file()}
        assert expected
        assert {path for path in expected if not (share / "rb_dynamics" / path).is_file()} == set()
