"""Installation by pip: all modules, shared files and commands, and no early imports."""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from email import message_from_string
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pytest

if TYPE_CHECKING:
    from email.message import Message
    from pathlib import Path

# The message packages are the contract's list; a ROS 2 graph needs the client and a middleware besides.
ROS = {
    "ros-jazzy-diagnostic-msgs",
    "ros-jazzy-geometry-msgs",
    "ros-jazzy-lifecycle-msgs",
    "ros-jazzy-nav-msgs",
    "ros-jazzy-rclpy",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-rosgraph-msgs",
    "ros-jazzy-sensor-msgs",
    "ros-jazzy-std-msgs",
    "ros-jazzy-std-srvs",
    "ros-jazzy-visualization-msgs",
}

# Imports every module that may not need ROS, and prints what optional packages that asked for.
IMPORT_ALL = """
import importlib, pkgutil, sys

OPTIONAL = {
    "dask", "distributed", "jinja2", "matplotlib", "mcap", "numba", "pyarrow", "rclpy", "rerun", "rosbags", "tqdm",
    "zstandard",
}
asked = set()

class Recorder:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in OPTIONAL:
            asked.add(name)
            raise ModuleNotFoundError(f"{name} is not there", name=name)

sys.meta_path.insert(0, Recorder())
import rb_dynamics

for module in pkgutil.walk_packages(rb_dynamics.__path__, "rb_dynamics."):
    if not module.name.startswith("rb_dynamics.ros.") and not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print(rb_dynamics.__file__, sorted(asked))
"""


def _run(*command: object, cwd: Path, env: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel pip builds of the tree."""
    out = tmp_path_factory.mktemp("wheel")
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation")
    _run(*pip, "--wheel-dir", out, source, cwd=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def names(wheel: Path) -> set[str]:
    """Return the names of the files in the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def metadata(wheel: Path) -> Message:
    """Return the metadata of the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_string(archive.read(name).decode())


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a virtual environment with the wheel installed, and this one's third parties in sight."""
    home = tmp_path_factory.mktemp("environment")
    venv.create(home, symlinks=True, with_pip=False)
    (site,) = home.glob("lib/python*/site-packages")
    # A bare path: what stands in *.pth files over there, an editable install above all, is not followed.
    (site / "third_parties.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    pip = (sys.executable, "-m", "pip", "--python", home / "bin" / "python")
    _run(*pip, "install", "--quiet", "--no-deps", "--no-index", "--ignore-installed", wheel, cwd=home)
    return home


def test_wheel_holds_every_module_and_data_file(source: Path, names: set[str]) -> None:
    files = {path for path in (source / "rb_dynamics").rglob("*") if path.is_file() and "__pycache__" not in path.parts}

    assert {name for path in files if (name := path.relative_to(source).as_posix()) not in names} == set()


def test_wheel_shares_scenes_launch_file_and_index(source: Path, names: set[str]) -> None:
    shared = {name.partition(".data/data/share/")[2] for name in names if ".data/data/share/" in name}
    folders = ("config", "examples", "launch")
    files = [path for folder in folders for path in (source / folder).rglob("*") if path.is_file()]

    assert shared == {
        "ament_index/resource_index/packages/rb_dynamics",
        "rb_dynamics/package.xml",
        *(f"rb_dynamics/{path.relative_to(source).as_posix()}" for path in files),
    }


def test_metadata_comes_from_package_xml(source: Path, metadata: Message) -> None:
    package = ElementTree.parse(source / "package.xml").getroot()

    assert metadata["Name"] in ("rb_dynamics", "rb-dynamics")
    assert metadata["Version"] == package.findtext("version")
    assert metadata["Summary"] == package.findtext("description")
    assert "Apache-2.0" in (metadata["License-Expression"], metadata["License"])
    assert metadata["Requires-Python"] == ">=3.10"


def test_extras_bring_what_they_promise(metadata: Message) -> None:
    brought: dict[str, set[str]] = {}
    for line in metadata.get_all("Requires-Dist", []):
        name = re.match(r"[\w.-]+", line)
        extra = re.search(r"extra == ['\"](\w+)['\"]", line)
        assert name
        brought.setdefault(extra[1] if extra else "", set()).add(name[0])

    assert brought.keys() == {
        *("", "bench", "dev", "docs", "fast", "igrf", "interactive", "log", "mesh", "plot", "ros", "scale", "test"),
        "video",
    }
    assert brought[""] == {"numpy", "scipy", "PyYAML"}
    assert brought["fast"] == {"numba"}
    assert brought["log"] == {"mcap", "rerun-sdk", "rosbags", "zstandard"}
    assert brought["ros"] == ROS
    assert brought["plot"] == {"jinja2", "matplotlib", "tqdm"}
    assert brought["scale"] == {"dask", "distributed", "pyarrow"}
    assert brought["igrf"] == {"ppigrf"}
    assert brought["mesh"] == {"trimesh"}
    assert brought["dev"] >= {"mypy", "ruff"}


def test_import_needs_nothing_optional(environment: Path, bare_environment: dict[str, str]) -> None:
    printed = _run(environment / "bin" / "python", "-c", IMPORT_ALL, cwd=environment, env=bare_environment)

    assert printed.startswith(str(environment))
    assert printed.endswith(" []\n")


def test_commands_are_installed(environment: Path, bare_environment: dict[str, str]) -> None:
    assert (environment / "bin" / "rigid_body").is_file()

    printed = _run(environment / "bin" / "rb-dynamics", "--help", cwd=environment, env=bare_environment)

    assert "simulate" in printed


def test_make_says_which_python_it_needs(source: Path, bare_environment: dict[str, str]) -> None:
    command = ["make", "test", "PYTHON=no-such-python"]

    done = subprocess.run(command, cwd=source, env=bare_environment, capture_output=True, text=True, check=False)

    assert done.returncode == 2
    assert done.stderr.startswith("No working 'no-such-python': install Python 3.10 or newer")
