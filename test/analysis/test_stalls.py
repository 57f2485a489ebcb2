"""Where the stamps of a pose go on and the body stands still is found, and nothing else is taken for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_rows import write_rows
from foreign_flights import foreign
from tumbling import Tumble, bag_of, spin

import rb_dynamics as rb
from rb_dynamics.analysis.inspection import inspect
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.message_types import WRENCH
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = """
body: {mass: 2.0, center_of_mass: [0.01, 0, 0], inertia: {matrix: [[0.5, 0.02, 0], [0.02, 0.7, 0.03], [0, 0.03, 0.9]]}}
initial: {angular_velocity_body: [0.3, 1.1, -0.2], linear_velocity_world: [0.1, 0, -0.2]}
wrenches: [{topic: thrust}, {topic: brief, timeout: 0.8}]
duration: 12.0
output_rate: 100.0
"""
COMMANDS = [
    ("thrust", rb.Wrench(tuple(force), tuple(torque), "body", 200_000_000 * (1 + k)))  # type: ignore[arg-type]
    for k, (force, torque) in enumerate(np.random.default_rng(5).normal(size=(55, 2, 3)).tolist())
]
# One is held over the first stall, and one came in the second.
BRIEF = [rb.Wrench((0.1, 0.0, 0.2), (0.3, -0.2, 0.1), "body", at) for at in (3_000_000_000, 7_110_000_000)]
EARLIER_NS = 10**18


def stalls(motion: Tumble) -> list[tuple[int, float]]:
    found = read_track(bag_of(motion)).stalls
    return [(each.start_ns - int(motion.time_ns[0]), each.stood_s) for each in found]


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("stood_s", [0.1, 0.35, 3.0])
def test_a_body_that_stood_still_is_found(noise: float, stood_s: float) -> None:
    motion = spin(noise=noise)
    later = replace(motion, time_ns=motion.time_ns + (np.arange(1000) >= 600) * round(stood_s * 1e9))
    ((at_ns, found_s),) = stalls(later)
    assert at_ns == 5_990_000_000
    assert found_s == pytest.approx(stood_s, abs=1e-5 if noise == 0.0 else 2e-3)


@pytest.mark.parametrize("stamps", ["even", "jitter"])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("rate", [0.01, 2.0, 2.0 * np.pi])
def test_a_hole_is_no_stall(stamps: str, noise: float, rate: float) -> None:
    """With 2 pi rad/s it turns by a whole turn in the hole of 1 s."""
    motion = spin(rate=rate, noise=noise, stamps=stamps)
    rows = np.arange(1000)
    for length in (3, 20, 99):
        assert stalls(motion.taken(rows[(rows < 400) | (rows >= 400 + length)])) == []


@pytest.mark.parametrize("kind", ["swings", "turns to and fro", "spins about another point"])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("periods", [0.93, 1.0, 1.1, 2.06, 6.5])
def test_a_hole_over_whole_periods_is_no_stall(periods: float, noise: float, kind: str) -> None:
    """The body is back where it was, and moves as it did: "the body stood still while the stamps went on"."""
    motion = spin(rate=0.0 if kind != "spins about another point" else 5.0, speed=0.0, noise=noise, count=3000)
    t = motion.time_ns[:, None] * 1e-9
    position, orientation = motion.position.copy(), motion.orientation_xyzw.copy()
    if kind == "swings":
        position += 0.2 * np.sin(5.0 * t) * np.array([1.0, 0.5, -0.2])
    elif kind == "turns to and fro":
        orientation += 0.3 * np.sin(5.0 * t) * np.array([1.0, 0.0, 0.0, 0.0])
        orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
    else:
        position += 0.05 * np.hstack([np.cos(5.0 * t), np.sin(5.0 * t), 0.0 * t]) + 1e-3 * t
    moved = replace(motion, position=position, orientation_xyzw=orientation)
    rows = np.arange(3000)
    for first in range(1400, 1520, 13):
        assert stalls(moved.taken(rows[(rows < first) | (rows >= first + round(periods * 40 * np.pi))])) == []


def test_a_body_at_rest_does_not_stand_still() -> None:
    motion = spin(rate=0.0, speed=0.0, noise=1e-4)
    assert stalls(replace(motion, time_ns=motion.time_ns + (np.arange(1000) >= 600) * 10**9)) == []


def recorded(folder: Path, brief: Sequence[rb.Wrench] = ()) -> tuple[Path, Path]:
    """Return a scene, and a bag of its flight whose stamps went on twice while the body stood still."""
    scene, run, bag = folder / "scene.yaml", folder / "run.mcap", folder / "paused.mcap"
    scene.write_text(SCENE)
    rb.simulate(rb.parse_scene(SCENE, str(scene)), [*COMMANDS, *(("brief", each) for each in brief)], [McapSink(run)])
    sent = [*COMMANDS, *(("brief", each) for each in brief[:1])]
    commands: list[tuple[str, int, Any]] = [
        (f"/{topic}", wrench.stamp_ns, (*wrench.force, *wrench.torque)) for topic, wrench in sent
    ]
    foreign(bag, run, later_ns=EARLIER_NS, commands=commands, pauses={3.37: 0.14, 7.11: 1.0})
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages()]
    for wrench in brief[1:]:
        stamp = EARLIER_NS + wrench.stamp_ns + 540_000_000
        rows.append(("/brief", WRENCH, stamp, cdr.encode(WRENCH, stamp, "body", (*wrench.force, *wrench.torque))))
    return scene, write_rows(folder / "whole.mcap", sorted(rows, key=lambda row: row[2]))


def test_the_inertia_explains_a_motion_with_stalls(tmp_path: Path) -> None:
    """The command held then would have acted all the time: "NO inertia explains the motion"."""
    scene, bag = recorded(tmp_path, BRIEF)
    found = inspect(bag, scene).summary
    assert {check.name for check in found.checks if not check.passed} == {
        "/vicon/pose is whole",
        "/vicon/twist is whole",
    }
    assert "inertia explains the motion" in {check.name for check in found.checks if check.passed}
    (note,) = (each for each in found.notes if "The body stood still while" in each)
    assert "for 0.14 s after t = 3.37 s; for 1 s after t = 7.25 s" in note


def test_a_fit_begins_again_after_a_stall(tmp_path: Path) -> None:
    scene, bag = recorded(tmp_path)
    found = rb.identify(scene, [bag])
    assert any("the body stood still while the stamps went on" in note for note in found.notes), found.notes
