"""The conformance command against our node over DDS: it passes, and a wrong description of the node fails."""

from __future__ import annotations

import subprocess
import sys

import pytest
import rclpy
from command_line import called
from ros_harness import ROOT, running

from rb_dynamics.ros.conformance import Conformance, main

pytestmark = pytest.mark.ros


def conformance(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rb_dynamics.ros.conformance", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=100, check=False, cwd=ROOT)


def test_the_node_conforms() -> None:
    with running(ROOT / "config" / "conformance.yaml") as node:
        done = conformance("--frame", "thruster:0,0.5,0.2", "--second", "push", "--timed", "burst:0.2")
        assert node.stop() == 0
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("holds") == 12


def test_a_lever_and_a_timeout_that_are_not_there_are_found_out() -> None:
    with running(ROOT / "config" / "conformance.yaml") as node:
        done = conformance("--frame", "thruster:0,0.4,0.2", "--timed", "burst:0.3")
        assert node.stop() == 0
    assert done.returncode == 1, done.stdout + done.stderr
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILS")]
    assert ["lever arm" in failed[0], "timeout" in failed[1], len(failed)] == [True, True, 2]


RELIABLE = ("-p", "qos_overrides./wrench.subscription.reliability:=reliable")


@pytest.mark.parametrize(
    ("arguments", "passed", "note"),
    [
        ((), True, "until the node met it"),
        (RELIABLE, True, "/rigid_body: wrench: a publisher's QoS"),
        pytest.param(
            (*RELIABLE, "-r", "/diagnostics:=/elsewhere"), False, "no diagnostics report it", marks=pytest.mark.slow
        ),
        (("-p", "qos_overrides./wrench.subscription.reliability:=best_effort"), True, "is compatible"),
    ],
)
def test_a_qos_that_does_not_fit_has_to_be_reported(arguments: tuple[str, ...], passed: bool, note: str) -> None:
    with running(ROOT / "config" / "conformance.yaml", *arguments) as node:
        rclpy.init(args=[])
        try:
            asking = Conformance(["wrench"])
            finding = asking.quality_of_service("wrench")
            asking.destroy_node()
        finally:
            rclpy.try_shutdown()
        assert node.stop() == 0
    assert finding.passed == passed
    assert note in finding.note


@pytest.mark.parametrize(
    ("option", "value"), [("--mass", "2.0"), ("--timed", "burst"), ("--frame", "thruster:0,1"), ("--center", "1")]
)
def test_options_that_are_not_whole_are_refused(option: str, value: str) -> None:
    done = called(main, option, value)
    assert done.returncode == 2
    assert option in done.stderr
