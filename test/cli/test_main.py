"""The command line as a newcomer finds it: without a command, and with words that it does not know."""

from __future__ import annotations

import re
from importlib import metadata

import pytest

import rb_dynamics
from rb_dynamics.cli import COMMANDS, main


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return what stands on stderr after a refusal with exit code 2, and nothing on stdout, in one line."""
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    out, err = capsys.readouterr()
    assert not out
    return re.sub(r"\s+", " ", err)


@pytest.mark.parametrize("arguments", [(), ("--ros-args", "-p", "a:=1")])
def test_no_command_shows_the_help(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert not out
    assert all(f"    {name} " in err for name in COMMANDS)


def test_unknown_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert "'simulat', expected a command (did you mean simulate?)" in refusal(capsys, "simulat", "scene.yaml")
    assert "expected a command; rb-dynamics --help" in refusal(capsys, "xyzzy")


def test_unknown_option_before_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert "usage: rb-dynamics [-h]" in (found := refusal(capsys, "--hlp"))
    assert "unrecognized arguments: --hlp (did you mean --help?)" in found


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("simulate s.yaml --metod rk4", "--method"),
        ("trade s.yaml --tiem=3", "--time"),
        ("body s.yaml --qq", ""),
        # Not cut short for another option, --rerun or --runs.
        ("campaign c.yaml --run 5", "--runs"),
    ],
)
def test_unknown_option_shows_the_usage_of_its_command(
    capsys: pytest.CaptureFixture[str], given: str, meant: str
) -> None:
    command, _, option = given.split()[:3]
    found = refusal(capsys, *given.split())
    assert f"usage: rb-dynamics {command} [-h]" in found
    assert f"{option} (did you mean {meant}?)" in found if meant else f"{option}; rb-dynamics {command} --help" in found


def test_ros_arguments_of_another_command(capsys: pytest.CaptureFixture[str]) -> None:
    found = refusal(capsys, "body", "s.yaml", "--ros-args")
    assert "usage: rb-dynamics body" in found
    assert "belongs to the commands node and replay" in found


def test_version_is_that_of_the_installed_package() -> None:
    try:
        installed = metadata.version("rb_dynamics")
    except metadata.PackageNotFoundError:
        installed = "not installed"
    assert rb_dynamics.__version__ == installed
    assert "__version__" in dir(rb_dynamics)
