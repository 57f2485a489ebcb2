"""The command line without a command and with unknown words."""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest

import rb_dynamics
from rb_dynamics.cli import COMMANDS, main


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return stderr, in one line, of a command that must print nothing on stdout and exit with code 2."""
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
    assert "expected a command; see rb-dynamics --help" in refusal(capsys, "xyzzy")


def test_unknown_option_before_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert "rb-dynamics: unrecognized arguments: --hlp (did you mean --help?); see" in refusal(capsys, "--hlp")


@pytest.mark.parametrize(("file", "use"), [("a/scene.yaml", "simulate"), ("run.mcap", "inspect")])
def test_a_file_instead_of_a_command(capsys: pytest.CaptureFixture[str], file: str, use: str) -> None:
    assert f"expected a command before the file, such as rb-dynamics {use} {file};" in refusal(capsys, file)


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
def test_unknown_option_is_answered_by_its_command(capsys: pytest.CaptureFixture[str], given: str, meant: str) -> None:
    command, _, option = given.split()[:3]
    found = refusal(capsys, *given.split())
    assert found.startswith(f"rb-dynamics {command}: unrecognized arguments: {option}")
    assert found.endswith(f"; see rb-dynamics {command} --help ")
    assert f" (did you mean {meant}?)" in found if meant else "did you mean" not in found


def test_ros_arguments_of_another_command(capsys: pytest.CaptureFixture[str]) -> None:
    found = refusal(capsys, "body", "s.yaml", "--ros-args")
    assert found.startswith("rb-dynamics body: found --ros-args, which belongs to the commands node and replay")


@pytest.mark.parametrize(
    "given", ["simulate", "simulate s.yaml --mcap", "simulate s.yaml --step 1 --accuracy 1", "replay r.mcap --into x"]
)
def test_what_argparse_finds_is_one_line_too(capsys: pytest.CaptureFixture[str], given: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(given.split())
    (line,) = capsys.readouterr().err.splitlines()
    command = given.partition(" ")[0]
    assert line.startswith(f"rb-dynamics {command}: ")
    assert line.endswith(f"; see rb-dynamics {command} --help")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("--mcap run.mcap", "-p mcap:=run.mcap"),
        ("--max-bag-size=100 --lockstep", "-p max_bag_size:=100 -p lockstep:=VALUE"),
        ("--set body.mass=2 --step 0.1", "-p body.mass:=2 -p solver.step:=0.1"),
    ],
)
def test_options_of_other_commands_are_parameters_of_a_node(
    capsys: pytest.CaptureFixture[str], given: str, told: str
) -> None:
    assert f"; a node takes parameters instead: --ros-args {told}; see" in refusal(
        capsys, "node", "s.yaml", *given.split()
    )
    assert "parameters" not in refusal(capsys, "node", "s.yaml", "other.yaml")


def test_arguments_of_ros_come_after_their_mark(capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, "node", "s.yaml", "-p", "lockstep:=true", "-r", "__ns:=/a")
    assert "come after --ros-args: --ros-args -p lockstep:=true -r __ns:=/a; see" in told


@pytest.mark.parametrize(
    ("given", "option", "other"),
    [
        ("simulate s.yaml --topic a=b", "--topic", "--wrench"),
        ("explain s.yaml --topic a=b", "--topic", "--wrench"),
        ("trade s.yaml --topic a=b", "--topic", "--wrench"),
        ("replay r.mcap --rate 0", "--rate", "--into ros"),
        ("replay r.mcap --clock", "--clock", "--into ros"),
        ("campaign c.yaml --mcap r.mcap", "--mcap", "--rerun"),
        ("body s.yaml --scale 1", "--scale", "--mesh"),
        ("body s.yaml --through 0 0 0", "--through", "--axis"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(
    capsys: pytest.CaptureFixture[str], given: str, option: str, other: str
) -> None:
    found = refusal(capsys, *given.split())
    assert f"found {option} without {other}, expected both; add {other}, or leave out {option}; see" in found


def test_version_is_that_of_the_installed_package(root: Path) -> None:
    try:
        installed = metadata.version("rb_dynamics")
    except metadata.PackageNotFoundError:
        installed = "not installed"
    assert rb_dynamics.__version__ == installed
    # What logs say they were made by.
    told = ElementTree.parse(root / "package.xml").findtext("version")
    assert installed in {told, "not installed"}, "another version than package.xml: run pip install -e . again"
    assert "__version__" in dir(rb_dynamics)


def test_an_empty_argument_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As of a variable that is not set: no log was written, without a word."""
    scene = tmp_path / "scene.yaml"
    scene.write_text("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nduration: 0.1\n")
    with pytest.raises(SystemExit, match="2"):
        main(["simulate", str(scene), "--mcap", ""])
    assert "found nothing after --mcap, as of a variable that is not set" in capsys.readouterr().err
