"""`compare`: two logs, a log and a foreign bag, a scene and a bag; aligned, and never across a gap."""

from __future__ import annotations

import json
import math
import re
import socket
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_rows import write_rows
from foreign_flights import TURN, foreign
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import rb_dynamics as rb
from rb_dynamics.analysis.command_differences import CommandDifference, command_differences
from rb_dynamics.analysis.interpolated_signal import Signal
from rb_dynamics.analysis.read_track import TopicChoice, read_track
from rb_dynamics.analysis.recording_differences import MOTION, Given, compare_tracks, difference
from rb_dynamics.analysis.time_alignment import Alignment
from rb_dynamics.cli import main
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.formats.merging import merge
from rb_dynamics.formats.message_types import POSE, WRENCH
from rb_dynamics.formats.recovery import recover
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import origin_of
from rb_dynamics.numerics.rotation_arrays import rotate_all
from rb_dynamics.report.comparison_text import as_text, verdict
from rb_dynamics.run.sink import Epoch, RunInfo
from rb_dynamics.run.state_change import StateChange
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = """
body: {mass: 2.0, center_of_mass: [0.01, 0, 0], inertia: {matrix: [[0.5, 0.02, 0], [0.02, 0.7, 0.03], [0, 0.03, 0.9]]}}
initial: {angular_velocity_body: [0.3, 1.1, -0.2], linear_velocity_world: [0.1, 0, -0.2]}
wrenches: [{topic: thrust}]
duration: 4.0
output_rate: 50.0
"""
COMMANDS = [
    ("thrust", rb.Wrench((1.0, 0.0, 0.0), (0.2, -0.1, 0.3), "body", 500_000_000)),
    ("thrust", rb.Wrench((0.0, 0.5, 0.0), (-0.4, 0.1, 0.0), "body", 1_700_000_000)),
    ("thrust", rb.Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "body", 3_100_000_000)),
]
LATER = 1_700_000_000_123_456_789


def fly(path: Path, commands: list[tuple[str, rb.Wrench]] = COMMANDS, **changed: Any) -> Path:
    overrides = {key.replace("__", "."): value for key, value in changed.items()}
    rb.simulate(rb.parse_scene(SCENE, "test.yaml", overrides), commands, [McapSink(path)])
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("compare")


@pytest.fixture(scope="module")
def log(folder: Path) -> Path:
    return fly(folder / "a.mcap")


@pytest.fixture(scope="module")
def heavier(folder: Path) -> Path:
    return fly(folder / "heavier.mcap", body__mass=2.5)


@pytest.fixture(scope="module")
def scene(folder: Path) -> Path:
    path = folder / "scene.yaml"
    path.write_text(SCENE)
    return path


def bag_commands(topic: str = "/thrust") -> list[tuple[str, int, tuple[float, ...]]]:
    return [(topic, wrench.stamp_ns, (*wrench.force, *wrench.torque)) for _, wrench in COMMANDS]


def test_a_log_and_itself_are_the_same_to_the_bit(log: Path) -> None:
    found = rb.compare(log, log, bound=0.0)
    told = found.as_dict()
    assert told["first_difference_s"] is None
    assert found.passed
    assert (told["aligned_by"], told["offset_s"], told["samples"]) == ("stamp", 0.0, 201)
    assert (told["commands"], told["body"], told["run"], told["notes"]) == ([], [], [], [])
    assert all(told[name]["max"] == told[name]["rms"] == 0.0 for name in MOTION)
    assert (found.compared_s, list(found.not_compared)) == (4.0, [])


def test_what_differs_is_named_and_beyond_a_bound(log: Path, heavier: Path) -> None:
    found = rb.compare(log, heavier, bound=1e-3)
    told = found.as_dict()
    assert told["body"] == [{"name": "mass", "a": 2.0, "b": 2.5}]
    assert told["commands"] == []
    assert found.beyond == ("position", "linear_velocity")
    assert told["attitude"]["max"] < 1e-12
    # Until the first force nothing but round-off differs.
    assert told["position"]["at_s"] == 4.0
    growth = found.differences["position"].growth(found.span_ns)
    assert sorted(growth) == growth
    one, other = (rb.inspect(path).track.pose.values[:, :3] for path in (log, heavier))  # type: ignore[union-attr]
    apart = np.linalg.norm(one - other, axis=1)
    assert told["position"]["max"] == apart.max()
    assert math.isclose(told["position"]["rms"], np.sqrt(np.mean(apart**2)), rel_tol=1e-14)
    assert told["angular_momentum"]["max"] < 1e-9 < told["kinetic_energy"]["max"]


def test_it_is_symmetric(log: Path, heavier: Path, folder: Path) -> None:
    bag = foreign(folder / "symmetric.mcap", heavier, later_ns=7_777_777, every=3)
    for one, other in ((log, heavier), (log, bag)):
        there, back = rb.compare(one, other).as_dict(), rb.compare(other, one).as_dict()
        assert there["samples"] == back["samples"]
        for name in MOTION:
            for key in ("max", "rms", "at_s"):
                assert math.isclose(there[name][key], back[name][key], rel_tol=1e-12), (name, key)


def test_commands_that_differ_are_named(log: Path, folder: Path) -> None:
    late = [*COMMANDS[:1], ("thrust", rb.Wrench((0.0, 0.5, 0.0), (-0.4, 0.1, 0.0), "body", 1_800_000_000)), COMMANDS[2]]
    (told,) = rb.compare(log, fly(folder / "late.mcap", late)).as_dict()["commands"]
    assert (told["topic"], told["a"], told["b"], told["first_difference_s"]) == ("thrust", 3, 3, 1.7)
    assert math.isclose(told["torque"], math.hypot(0.6, 0.2, 0.3))
    (told,) = rb.compare(log, fly(folder / "coast.mcap", [])).as_dict()["commands"]
    assert (told["a"], told["b"], told["first_difference_s"]) == (3, 0, 0.5)


def test_the_lag_of_a_foreign_bag_is_found_and_with_it_every_bit(log: Path, folder: Path) -> None:
    bag = foreign(folder / "shifted.mcap", log, later_ns=LATER, negative=True)
    found = rb.compare(log, bag)
    assert found.alignment.by == "lag"
    assert found.alignment.offset_ns == LATER
    assert not found.alignment.doubtful
    assert found.first_ns is None
    told = found.as_dict()
    assert told["commands"] is None
    assert told["body"] is None
    assert {note.split(" ", 1)[0] for note in told["notes"]} == {"Commands", "Mass"}
    # Back again the same, and without a choice nothing else would fit.
    assert rb.compare(bag, log).alignment.offset_ns == -LATER
    with pytest.raises(
        rb.LogError, match=r"goes from 0 to 4 s and .* from 1700000000.123457 to .*simulation time.*leave out --align"
    ):
        rb.compare(log, bag, align="stamp")
    with pytest.raises(rb.LogError, match="expected --from and --to within both; give them from 0 to 4"):
        rb.compare(log, bag, start_s=7.0)


def test_recordings_without_a_common_time_in_which_nothing_changes_are_told_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(tmp_path / "a.mcap")
    scene = rb.parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 4\n")
    rb.simulate(scene, sinks=[McapSink(log)])
    early, late = (str(tmp_path / name) for name in ("early.mcap", "late.mcap"))
    assert main(["convert", log, early, "--to", "1"]) == 0
    assert main(["convert", log, late, "--from", "2"]) == 0
    capsys.readouterr()
    assert main(["compare", late, early]) == 2
    error = capsys.readouterr().err
    assert f"{late} goes from 2 to 4 s and {early} from 0 to 1 s by their stamps, with no time in common" in error
    assert "say how with --align" in error


def test_a_lag_that_is_doubtful_gives_no_result(log: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Another motion: differences at the lag that fits best, which was said to be doubtful, passed as results."""
    run = fly(folder / "unlike.mcap", [], initial__angular_velocity_body=[-1.0, 0.2, 0.7])
    bag = foreign(folder / "unlike_later.mcap", run, later_ns=LATER)
    assert main(["compare", str(log), str(bag), "--json"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "no lag that is certain" in printed.err
    assert main(["compare", str(log), str(bag), "--json", "--align", str(LATER / 1e9)]) == 0


@pytest.mark.parametrize("align", ["start", LATER / 10**9, "exact"])
def test_alignment_as_asked(log: Path, folder: Path, align: Any) -> None:
    from decimal import Decimal

    bag = foreign(folder / "asked.mcap", log, later_ns=LATER)
    found = rb.compare(log, bag, align=Decimal(LATER) / 10**9 if align == "exact" else align)
    assert abs(found.alignment.offset_ns - LATER) < 300
    assert found.alignment.by == ("start" if align == "start" else "seconds")
    assert found.differences["attitude"].max < 1e-6


def test_stamps_that_are_off_are_noticed(log: Path, folder: Path) -> None:
    bag = foreign(folder / "off.mcap", log, later_ns=300_000_000)
    found = rb.compare(log, bag)
    assert found.alignment.by == "stamp"
    assert any("--align 0.3" in note for note in found.notes)
    assert not any("--align" in note for note in rb.compare(log, bag, align=0.3).notes)


def test_curves_break_at_their_own_gaps_and_signs_go_on_across_them(log: Path, folder: Path) -> None:
    from rb_dynamics.report.comparison_page import _panels

    bags = [
        foreign(folder / f"gap_of_{name}.mcap", log, without=[gap])
        for name, gap in (("a", (0.5, 3.0)), ("b", (3.2, 3.7)))
    ]
    found = rb.compare(*bags, align="stamp")
    for panel in _panels(found, MOTION):
        for line in panel.lines:
            assert (float(line.time_s[0]), float(line.time_s[-1])) == (0.0, 4.0)
            assert math.isclose(float(np.diff(line.time_s).max()), 2.5 if line.label.endswith("A") else 0.5)
    attitude = {line.label: line for line in _panels(found, MOTION)[0].lines}
    for one, other in ((attitude[f"{name} A"], attitude[f"{name} B"]) for name in "xyzw"):
        assert float(np.abs(np.diff(other.values)).max()) < 0.5
        _, at, beside = np.intersect1d(one.time_s, other.time_s, return_indices=True)
        assert np.abs(one.values[at] - other.values[beside]).max() < 1e-9


class _LogOfNode(McapSink):
    """A log with the ROS times of time 0 of a node, and since when each."""

    epochs: tuple[tuple[float, int], ...] = ()

    def open(self, run: RunInfo) -> None:
        super().open(run)
        for since, epoch_ns in self.epochs:
            self.write(Epoch(round(since * 1e9), epoch_ns))


@pytest.mark.parametrize("recovered", [False, True], ids=["whole", "recovered"])
def test_a_bag_in_ros_time_is_compared_across_pauses_of_its_node(folder: Path, recovered: bool) -> None:
    """ROS time goes on in a pause, and where a node falls behind: the motions "differed" from there on."""
    pauses, first = {1.3: 0.35, 2.0: 1.0}, LATER
    sink = _LogOfNode(folder / f"node {recovered}.mcap")
    sink.epochs = ((0.0, first), (1.3, first + 350_000_000), (2.0, first + 1_350_000_000))
    stamped = [(topic, replace(wrench, stamp_ns=wrench.stamp_ns)) for topic, wrench in COMMANDS]
    rb.simulate(rb.parse_scene(SCENE, "test.yaml"), stamped, [sink])
    run = folder / f"node {recovered}.mcap"
    if recovered:
        recover(run, run := folder / "again.mcap")
    bag = foreign(folder / "paused.mcap", run, later_ns=first, pauses=pauses, commands=bag_commands())
    for a, b in ((run, bag), (bag, run)):
        found = rb.compare(a, b, bound=0.0)
        assert found.passed
        assert found.samples == 201
        assert found.commands == []
        assert any("stood still for 1.35 s in all" in note for note in found.notes)
    with pytest.raises(rb.LogError, match="no lag that is certain"):
        rb.compare(fly(folder / "unaware.mcap"), bag)


def test_ros_times_of_a_damaged_log_are_no_traceback(folder: Path) -> None:
    sink = _LogOfNode(folder / "damaged.mcap")
    sink.epochs = ((0.0, LATER), (1.3, 9_999_999_999_999_999_999))
    rb.simulate(rb.parse_scene(SCENE, "test.yaml"), COMMANDS, [sink])
    bag = foreign(folder / "of damaged.mcap", folder / "damaged.mcap")
    assert rb.compare(folder / "damaged.mcap", bag, bound=0.0).passed


def test_of_commands_stamped_in_a_pause_the_newest_by_its_stamp_acts_after_it(folder: Path) -> None:
    """The one that was recorded last did: commands "differed" where the node had gone by their stamps."""
    first, pauses = LATER, {1.3: 0.35}
    sink = _LogOfNode(folder / "node by stamps.mcap")
    sink.epochs = ((0.0, first), (1.3, first + 350_000_000))
    acted = [("thrust", rb.Wrench(force, (0.0, 0.0, 0.1), "body", round(1e9 * at))) for at, force in (
        (0.5, (1.0, 0.0, 0.0)), (1.3, (0.0, 0.7, 0.0)), (2.0, (0.0, 0.0, 0.4)),
    )]  # fmt: skip
    rb.simulate(rb.parse_scene(SCENE, "test.yaml"), acted, [sink])
    motion = foreign(folder / "motion of node.mcap", folder / "node by stamps.mcap", later_ns=first, pauses=pauses)
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(motion).messages()]

    def recorded(name: str, latest: tuple[float, ...]) -> Path:
        # When they were recorded, their stamps, and what they command; the pause is from 1.3 to 1.65 s.
        sent = [
            *((at, at, "body", (1.0, 0.0, 0.0)) for at in (0.5, 0.6, 0.7, 0.8, 0.9)),
            (1.35, 1.6, "body", latest), (1.4, 1.45, "world", (0.0, 0.0, 0.6)),
            (1.41, 1.5, "body", (0.0, 0.2, 0.0)), (2.35, 2.35, "body", (0.0, 0.0, 0.4)),
        ]  # fmt: skip
        commands = [
            (
                "/thrust",
                WRENCH,
                first + round(1e9 * at),
                cdr.encode(WRENCH, first + round(1e9 * stamp), frame, (*force, 0.0, 0.0, 0.1)),
            )
            for at, stamp, frame, force in sent
        ]
        return write_rows(folder / name, sorted([*rows, *commands], key=lambda row: row[2]))

    found = rb.compare(folder / "node by stamps.mcap", recorded("by stamps.mcap", (0.0, 0.7, 0.0)), bound=0.0)
    assert found.commands == []
    other = rb.compare(folder / "node by stamps.mcap", recorded("another.mcap", (0.0, 0.5, 0.0)))
    assert [each.topic for each in other.commands or ()] == ["thrust"]


def test_nothing_is_compared_within_a_gap(log: Path, folder: Path) -> None:
    bag = foreign(folder / "gap.mcap", log, without=[(1.0, 1.5), (2.0, 2.2)])
    told = rb.compare(log, bag, align="stamp").as_dict()
    assert math.isclose(told["compared_s"], 3.3)
    assert any("0.7 s in 2 gaps of B, the longest 0.5 s from t = 1 s" in part for part in told["not_compared"])
    # At stamps between two of the other there is nothing in the gap either.
    sparse = foreign(folder / "sparse.mcap", log, every=4, later_ns=5_000_000)
    found = rb.compare(bag, sparse, align=0.005)
    times = found.seconds(found.differences["attitude"].time_ns)
    assert not np.any((times > 1.0) & (times < 1.5))


def test_commands_within_a_gap_do_not_differ(log: Path, folder: Path) -> None:
    brief = [
        COMMANDS[0],
        ("thrust", rb.Wrench((0.0, 0.0, 0.0), (-0.1, 0.1, 0.0), "body", 1_500_000_000)),
        *COMMANDS[1:],
    ]
    whole = fly(folder / "brief.mcap", brief)
    parts = [folder / "before.mcap", folder / "after.mcap"]
    merge([whole], parts[0], (-math.inf, 1.2e9))
    merge([whole], parts[1], (2.0e9, math.inf))
    both = folder / "parts.mcap"
    merge(parts, both, (-math.inf, math.inf))
    found = rb.compare(whole, both)
    assert found.commands is None
    assert any("Commands on thrust differ only within gaps of the motion" in note for note in found.notes)
    # What is held when the gap ends does count, and so does all without one.
    (told,) = rb.compare(log, fly(folder / "other.mcap", [COMMANDS[0]])).as_dict()["commands"]
    assert told["first_difference_s"] == 1.7
    merge([folder / "other.mcap"], parts[1], (2.0e9, math.inf))
    merge(parts, both, (-math.inf, math.inf))
    (told,) = rb.compare(log, both).as_dict()["commands"]
    assert told["first_difference_s"] == 2.0


def test_unequal_lengths_are_said(log: Path, folder: Path) -> None:
    longer = fly(folder / "longer.mcap", duration=5.0)
    found = rb.compare(log, longer)
    assert list(found.not_compared) == ["1 s of B after what both have"]
    assert found.samples == 201
    windowed = rb.compare(log, longer, start_s=1.0, end_s=2.0)
    assert windowed.samples == 51
    assert windowed.as_dict()["first_difference_s"] == found.as_dict()["first_difference_s"] or windowed.first_ns


def test_a_regression_check_asks_for_the_share_that_is_compared(
    log: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that stopped after a twentieth of the time was within every bound."""
    short = fly(folder / "short.mcap", duration=1.0)
    line = ["compare", str(log), str(short), "--bound", "1e-9"]
    assert main(line) == 0
    assert "within 1e-09 over 25 % of the longer one" in capsys.readouterr().out
    assert main([*line, "--share", "0.3"]) == 1
    assert "ONLY 25 % of the longer one compared, asked 30 %" in capsys.readouterr().out
    for more in (["--share", "0.24"], ["--share", "1", "--to", "1"]):
        assert main([*line, *more]) == 0
    # Of each quantity that is judged, gaps apart.
    bag = foreign(folder / "share.mcap", log, without=[(1.0, 3.0)])
    for share, code in ((0.5, 0), (0.6, 1)):
        assert rb.compare(log, bag, align="stamp", share=share).passed is (code == 0)
    assert rb.compare(log, bag, align="stamp").as_dict()["compared_share"] == 0.5
    with pytest.raises(ValueError, match="share"):
        rb.compare(log, short, share=1.1)


def test_other_output_rates_are_compared_at_common_stamps(log: Path, folder: Path) -> None:
    faster = fly(folder / "faster.mcap", output_rate=75.0)
    found = rb.compare(log, faster)
    assert found.first_ns is None
    assert found.samples == 101
    assert found.differences["attitude"].interpolated == 0


def test_what_is_interpolated_is_said_with_its_error(log: Path, folder: Path) -> None:
    bag = foreign(folder / "between.mcap", log, every=5, later_ns=10_000_000)
    each = rb.compare(log, bag, align=0.007).differences["attitude"]
    assert each.interpolated == len(each.size)
    assert each.interpolation < 1e-3
    # 3 ms at about 1.2 rad/s.
    assert abs(each.rms - 3e-3 * 1.2) < 1e-3


@pytest.mark.parametrize(("rate", "late_ns"), [(20, 0), (33, 0), (50, 0), (50, 1_000_000)])
def test_the_rms_does_not_depend_on_how_densely_samples_are_compared(rate: int, late_ns: int) -> None:
    """Samples between common stamps count where they differ; counted as samples, rms was up to 35 % too high."""

    def shifted(rate: int, by: float) -> Signal:
        time_ns = np.round(np.arange(0.0, 30.001, 1.0 / rate) * 1e9).astype(np.int64)
        if by:
            time_ns[np.arange(len(time_ns)) % 9 > 0] += late_ns
        values = np.outer(time_ns * 1e-9, (1.0, 2.0, 3.0))
        values[time_ns > 15_000_000_000, 0] += by
        return Signal.of(time_ns, values)

    found = difference("position", "world", shifted(50, 0.0), shifted(rate, 0.01))
    assert found is not None
    assert found.max == pytest.approx(0.01, rel=1e-9)
    assert found.rms == pytest.approx(0.01 * math.sqrt(0.5), rel=0.01)


def test_commands_to_actuators_of_a_foreign_bag_are_said_not_to_be_compared(folder: Path) -> None:
    """They were called the same, and those to a thruster others than the very commands that were simulated."""
    scene = rb.parse_scene(
        "body: {mass: 10, inertia: {diagonal: [1, 2, 3]}, frames: {j: {position: [0, 0, 0]}}}\nduration: 5\n"
        "wrenches: [{topic: wrench}]\nactuators: [{type: thruster, name: jet, frame: j, force: 1, command: level}, "
        "{type: reaction_wheel, name: wh, axis: [0, 0, 1], inertia: 0.001, command: torque, max_torque: 0.1}]\n"
    )
    log, number = folder / "jets.mcap", "std_msgs/msg/Float64"
    push = [("wrench", rb.Wrench((0.1, 0.0, 0.0), stamp_ns=k * 10**9)) for k in range(5)]
    sent = [*push, ("jet/command", rb.Setpoint(1.0, 2 * 10**9))]
    rb.simulate(scene, sent, [McapSink(log)])
    rows = [
        (f"/{name}/command", number, 2 * 10**9, cdr.encode(number, (value,)))
        for name, value in (("jet", 1.0), ("wh", 0.01))
    ]
    for sample in range(101):
        at = sample * 5 * 10**7
        rows.append(("/pose", POSE, at, cdr.encode(POSE, at, "world", (0.0,) * 6 + (1.0,))))
    rows += [
        ("/wrench", WRENCH, at * 10**9, cdr.encode(WRENCH, at * 10**9, "body", (0.1,) + (0.0,) * 5)) for at in range(5)
    ]
    bag = write_rows(folder / "jets_of_others.mcap", rows)
    for pair in ((log, bag), (bag, log), (scene, bag)):
        found = rb.compare(*pair, align="stamp") if scene not in pair else rb.compare(*pair)
        assert found.commands is None
        assert any("Commands to jet, wh are not compared" in note for note in found.notes)
    spaced = folder / "jets_of_a_namespace.mcap"
    rb.simulate(scene, sent, [McapSink(spaced, namespace="/sat")])
    found = rb.compare(spaced, bag, align="stamp")
    assert found.commands is None
    assert any("Commands to jet, wh are not compared" in note for note in found.notes)


def test_what_follows_with_a_lag_is_compared_at_common_times_only(folder: Path) -> None:
    """The log has samples of it at outputs: held from one to the next, those of another rate were called different."""
    lagging = {"wrenches": [{"topic": "thrust", "lag": 0.1}]}
    slow, fast, other = (folder / f"lagging_{name}.mcap" for name in ("slow", "fast", "other"))
    for path, rate, commands in ((slow, 40.0, COMMANDS), (fast, 50.0, COMMANDS), (other, 50.0, COMMANDS[:2])):
        fly(path, commands, output_rate=rate, **lagging)
    assert rb.compare(slow, fast).commands == []
    differing = rb.compare(slow, other).commands
    assert differing is not None
    assert [each.first_ns for each in differing] == [3_200_000_000]
    # Between the samples, nobody knows what acted.
    apart = rb.compare(slow, fast, align=0.003)
    assert apart.commands is None
    assert "followed them with a lag" in " ".join(apart.notes)
    assert "differ at interpolated samples only" in verdict(apart)
    without = rb.compare(slow, fly(folder / "lagging_without.mcap", [], wrenches=[{"topic": "idle"}]))
    assert without.commands is not None
    assert len(without.commands) == 1


def test_commands_to_actuators_and_changed_devices_are_named(folder: Path) -> None:
    """Nothing of what acts on a wheel or a rod is a wrench: their commands were called the same."""
    wheel = {"type": "reaction_wheel", "name": "wheel", "axis": [0, 0, 1], "inertia": 0.001}
    asked = [(0.004, 500_000_000), (-0.006, 2_000_000_000)]

    def flown(name: str, values: list[tuple[float, int]], **changed: float) -> Path:
        path = folder / f"wheel_{name}.mcap"
        commands = [("wheel/command", rb.Setpoint(value, at)) for value, at in values]
        scene = rb.parse_scene(SCENE, "test.yaml", {"actuators": [{**wheel, **changed}]})
        rb.simulate(scene, commands, [McapSink(path)])
        return path

    run = flown("run", asked)
    assert rb.compare(run, flown("again", asked)).commands == []
    for name, values, first_ns, size, counts in (
        ("other", [asked[0], (-0.0061, 2_000_000_000)], 2_000_000_000, 1e-4, (2, 2)),
        ("more", [*asked, (0.002, 3_000_000_000)], 3_000_000_000, 0.008, (2, 3)),
        ("earlier", [(0.001, 400_000_000), *asked], 400_000_000, 0.001, (2, 3)),
        ("none", [], 500_000_000, 0.006, (2, 0)),
    ):
        (found,) = rb.compare(run, flown(name, values)).commands or ()
        assert (found.topic, found.first_ns, found.unit, (found.a, found.b)) == (
            "wheel/command", first_ns, "N m", counts,
        )  # fmt: skip
        assert found.value == pytest.approx(size)
    # What is held from before the part that is compared counts; a command that repeats the last one does not.
    (held,) = rb.compare(run, flown("held", [(0.005, 500_000_000), asked[1]]), start_s=1.0).commands or ()
    assert (held.first_ns, held.value) == (1_000_000_000, pytest.approx(0.001))
    assert rb.compare(run, flown("repeated", [*asked, (-0.006, 3_000_000_000)])).commands == []
    changed = rb.compare(run, flown("heavier", asked, inertia=0.002))
    assert ("actuators.wheel.inertia", 0.001, 0.002) in changed.run


def test_a_flight_that_goes_on_between_two_outputs_differs_by_no_more_than_interpolation_adds(folder: Path) -> None:
    """A command within an interval bends the velocities there: that was called a difference beyond interpolation."""
    commands = [("thrust", replace(wrench, stamp_ns=wrench.stamp_ns + 11_000_000)) for _, wrench in COMMANDS]
    whole, shifted = fly(folder / "on_grid.mcap", commands), fly(folder / "off_grid.mcap", commands, output_rate=80.0)
    assert rb.compare(whole, shifted).first_ns is None
    track = read_track(read_bag(shifted))
    assert track.pose is not None
    off = track.pose.time_ns % 100_000_000 != 0
    cut = replace(track, **{name: _rows(getattr(track, name), off) for name in ("pose", "twist")})
    found = compare_tracks(Given(read_track(read_bag(whole)), "a"), Given(cut, "b"), Alignment("stamp", 0), 1e-6)
    assert "at interpolated samples only, by no more than interpolation adds; BEYOND 1e-06" in verdict(found)


@pytest.mark.parametrize(
    ("commands", "spin"), [([], [0.3, 1.1, -0.2]), (COMMANDS, [3.0, 6.0, -1.0])], ids=["rounding", "estimate"]
)
def test_one_motion_at_other_times_differs_by_no_more_than_interpolation_adds(
    commands: Any, spin: list[float], folder: Path
) -> None:
    """Half of all pairs of one run at two rates were told to differ by more."""

    def run(rate: float, first: float) -> Path:
        scene = {"body__center_of_mass": [0, 0, 0], "initial__angular_velocity_body": [first, *spin[1:]]}
        return fly(folder / f"{rate:g} {first:g}.mcap", commands, output_rate=rate, **scene)

    one, other, faster = run(37.1, spin[0]), run(43.7, spin[0]), run(43.7, 1.05 * spin[0])
    assert verdict(rb.compare(one, other)).endswith("interpolated samples only, by no more than interpolation adds")
    said = verdict(rb.compare(one, faster, start_s=0.1, end_s=3.9))
    assert said.startswith(
        "the motions differ at interpolated samples only, by more than interpolation is estimated to add in"
    )


def _rows(series: Any, kept: Any) -> Any:
    return replace(series, time_ns=series.time_ns[kept], values=series.values[kept])


def test_the_body_of_the_one_that_has_one_is_told(log: Path, folder: Path) -> None:
    """A page on a changed inertia, against a bag without one, did not say which."""
    bag = foreign(folder / "bodiless.mcap", log)
    found = rb.compare(log, bag, align="stamp")
    assert found.body is None
    assert "body      of A alone: mass 2 kg, center of mass [0.01, 0, 0] m, inertia [[0.5, 0.02, 0]" in as_text(found)


def test_without_a_twist_velocities_are_null(log: Path, folder: Path) -> None:
    bag = foreign(folder / "poses.mcap", log, twist=False, later_ns=LATER)
    told = rb.compare(log, bag).as_dict()
    assert told["aligned_by"] == "lag"
    assert abs(told["offset_ns"] - LATER) < 2_000_000
    assert (told["angular_velocity"], told["linear_velocity"]) == (None, None)
    assert "angular velocity: B does not tell" in told["not_compared"]


def test_two_topics_of_one_bag(log: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moved = foreign(folder / "moved.mcap", log, shifted=(0.5, 0.0, 0.0))
    both = folder / "both.mcap"
    merge([moved, log], both, (-math.inf, math.inf))
    line = ["compare", str(both), str(both), "--pose-topic", "/odom", "--pose-topic", "/vicon/pose"]
    assert main([*line, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["attitude"]["max"], found["position"]["max"]) == (0.0, pytest.approx(0.5, abs=1e-12))
    # Nothing but the pose tells of the second, though the bag has other twists and momenta.
    assert (found["angular_velocity"], found["linear_velocity"]) == (None, None)
    assert main([*line, "--twist-topic", "/odom", "--twist-topic", "vicon/twist", "--scene", str(log)]) == 0
    text = capsys.readouterr().out
    assert f"A         {both}, /odom: " in text
    assert f"B         {both}, /vicon/pose, /vicon/twist: " in text
    gyros = rb.compare(both, both, topics=(rb.TopicChoice(twist="/odom"), rb.TopicChoice(twist="/vicon/twist")))
    assert list(gyros.differences) == ["angular_velocity", "linear_velocity"]
    # A topic that is given for both would agree with itself, and pass any bound.
    assert main([*line, "--twist-topic", "/odom", "--bound", "angular_velocity=1e-9"]) == 2
    assert "the twist of both is that of /odom, which agrees with itself" in capsys.readouterr().err
    # Of two recordings each has its topic; what is not named is found.
    one = rb.compare(log, both, topics=(rb.TopicChoice(pose="/odom"), rb.TopicChoice(pose="/vicon/pose")))
    assert one.differences["position"].max == pytest.approx(0.5, abs=1e-12)
    assert one.differences["angular_velocity"].max == 0.0
    with pytest.raises(SystemExit) as stopped:
        main([*line, "--pose-topic", "/pose"])
    assert stopped.value.code == 2
    assert main([*line[:-1], "/none"]) == 2
    # A topic and frames, in either order: of A and of B.
    line[3:] = ["--frames", "world:body", "--pose-topic", "/vicon/pose", "--json"]
    capsys.readouterr()
    for order in (line, [*line[:3], *line[5:7], *line[3:5], "--json"]):
        assert main(order) == 0
        assert json.loads(capsys.readouterr().out)["position"]["max"] == pytest.approx(0.5, abs=1e-12)


def test_poses_of_one_log_have_its_commands_in_the_frames_of_its_scene(folder: Path) -> None:
    log, sensor = folder / "seen.mcap", "sensors: [{type: pose, name: tracker, rate: 20}]\n"
    rb.simulate(rb.parse_scene(SCENE + sensor), COMMANDS, [McapSink(log)])
    found = rb.compare(log, log, topics=(rb.TopicChoice(pose="/pose"), rb.TopicChoice(pose="/tracker")))
    assert found.commands == []
    assert not any("not declared" in note for note in found.notes)


def test_axes_that_are_turned_are_named_and_nothing_is_corrected(log: Path, folder: Path) -> None:
    bag = foreign(folder / "turned.mcap", log, turned_body=True, shifted=(0.0, 0.25, 0.0))
    found = rb.compare(log, bag, align="stamp")
    assert abs(found.differences["attitude"].max - 0.1) < 1e-12
    (turned,) = (note for note in found.notes if "are turned" in note)
    assert "body axes of B are turned against those of A by 0.1 rad" in turned
    assert "about (0, 0, 1)" in turned or "about (0, 0, -1)" in turned
    assert any("positions of B lie" in note and "0.25" in note for note in found.notes)
    assert TURN[3] < 1.0


@pytest.mark.parametrize(
    ("written", "told"),
    [
        (lambda q: q * [-1, -1, -1, 1], "The quaternions of one of the two look like the inverse"),
        (lambda q: np.roll(q, 1, axis=1), "The quaternions of B look like w, x, y, z in place of x, y, z, w"),
    ],
    ids=["inverse", "w first"],
)
def test_quaternions_as_another_writes_them_are_named(log: Path, folder: Path, written: Any, told: str) -> None:
    bag = read_track(read_bag(foreign(folder / "quaternions.mcap", log)))
    assert bag.pose is not None
    values = np.hstack([bag.pose.values[:, :3], written(bag.pose.values[:, 3:])])
    other = replace(bag, pose=replace(bag.pose, values=values))
    found = compare_tracks(Given(bag, "a"), Given(other, "b"), Alignment("stamp", 0))
    (note,) = (note for note in found.notes if "quaternions" in note)
    assert note.startswith(told)
    assert found.differences["attitude"].max > 0.1
    back = compare_tracks(Given(other, "a"), Given(bag, "b"), Alignment("stamp", 0))
    assert any(each.startswith(told.replace("of B", "of A")) for each in back.notes)
    alike = compare_tracks(Given(bag, "a"), Given(bag, "b"), Alignment("stamp", 0))
    assert not any("quaternions" in each for each in alike.notes)


@pytest.mark.parametrize("every", [1, 2, 3])
def test_another_point_of_the_body_and_another_body_frame_are_named(log: Path, folder: Path, every: int) -> None:
    """At other rates than those of A, the point was not named."""
    bag = read_track(read_bag(foreign(folder / "point.mcap", log)))
    pose, twist = bag.pose, bag.twist
    assert pose is not None
    assert twist is not None
    lever = rotate_all(pose.values[:, 3:], np.array([[0.1, 0.05, -0.2]]))
    moved = replace(pose, values=np.hstack([pose.values[:, :3] + lever, pose.values[:, 3:]]))
    moved = replace(moved, time_ns=moved.time_ns[::every], values=moved.values[::every])
    other = replace(bag, pose=moved, twist=replace(twist, frame="imu"))
    found = compare_tracks(Given(bag, "a"), Given(other, "b"), Alignment("stamp", 0))
    told = " ".join(found.notes)
    assert "lie (0.1, 0.05, -0.2) m from those of A in the body axes of A, throughout" in told
    assert f'The twists of A are of the frame "{twist.frame}", those of B of "imu"' in told


@pytest.mark.parametrize("side", ["A", "B"])
def test_velocities_that_look_like_those_in_world_axes_are_named(log: Path, folder: Path, side: str) -> None:
    track = read_track(read_bag(foreign(folder / "axes.mcap", log)))
    pose, twist = track.pose, track.twist
    assert pose is not None
    assert twist is not None
    parts = [rotate_all(pose.values[:, 3:], twist.values[:, columns]) for columns in (slice(0, 3), slice(3, 6))]
    other = replace(track, twist=replace(twist, values=np.hstack(parts)))
    sides = [Given(track, "a"), Given(other, "b")][:: 1 if side == "B" else -1]
    told = [note for note in compare_tracks(*sides, Alignment("stamp", 0)).notes if "looks like one in world" in note]
    assert [note.partition(" looks")[0] for note in told] == [
        f"The {name} velocity of {side}" for name in ("angular", "linear")
    ]


def test_a_lag_that_is_hardly_known_is_none_and_pieces_of_one_clock_are_named(log: Path, folder: Path) -> None:
    """Without a torque speeds nearly repeat: of two pieces of a flight, a lag left half a radian, known to 0.7 s."""
    assert "known to +- 0.7 s only, of 3.6 s" in " ".join(Alignment("lag", 0, 0.7, None, 0.1, 3.6).doubts)
    assert not Alignment("lag", 0, 0.3, None, 0.1, 3.6).doubtful
    found = rb.compare(log, foreign(folder / "piece.mcap", log, later_ns=10_000_000_000))
    assert (found.alignment.by, found.alignment.offset_ns) == ("lag", 10_000_000_000)
    assert any("they have no time in common: B begins 6 s after the other ends" in note for note in found.notes)


@given(st.tuples(*[st.floats(-1.5, 1.5)] * 3).filter(lambda v: math.hypot(*v) > 1e-3))
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_known_rotation_between_two_is_what_is_found(vector: tuple[float, ...]) -> None:
    from rb_dynamics.numerics.rotation_arrays import exponentials, product

    times = np.arange(50) * 10**8
    attitude = exponentials(np.outer(times * 1e-9, [0.3, 0.2, -0.5]))
    turned = product(attitude, exponentials(np.array([vector])))
    found = difference("attitude", "", Signal.of(times, attitude), Signal.of(times, turned))
    back = difference("attitude", "", Signal.of(times, turned), Signal.of(times, attitude))
    assert found is not None
    assert back is not None
    assert np.allclose(found.size, math.hypot(*vector), rtol=1e-13)
    assert np.array_equal(found.size, back.size)


def test_what_comes_after_the_last_common_stamp_is_compared_too() -> None:
    """Clocks that agree for a while only: whatever followed was left out."""
    times = np.arange(1000) * 10_000_000
    late = np.where(times < times[500], times, times + 1_000_000)
    values = np.outer(times * 1e-9, (1.0, 0.0, 0.0))
    off = np.where(times < times[500], 0.0, 1.0)[:, None]
    a, b = Signal.of(times, values), Signal.of(late, values + off)
    for one, other in ((a, b), (b, a)):
        found = difference("position", "world", one, other)
        assert found is not None
        assert found.size.max() > 0.99
        assert len(found.time_ns) == 999
        assert found.interpolated == 499


def test_the_error_of_interpolation_is_that_of_whichever_is_interpolated() -> None:
    """Only that of the finer one was told, six times less here, while samples between those of the other counted."""
    fine, coarse = np.arange(2000) * 10_000_000, np.arange(740) * 27_000_000
    at = [np.outer(np.sin(times * 1e-9), (1.0, 0.0, 0.0)) for times in (fine, coarse)]
    a, b = Signal.of(fine, at[0]), Signal.of(coarse, at[1] + 0.002)
    for one, other in ((a, b), (b, a)):
        found = difference("position", "world", one, other)
        assert found is not None
        worst = np.abs(found.size - 0.002 * math.sqrt(3.0)).max()
        assert worst > 3e-5
        assert worst <= found.interpolation < 1.5e-4


def test_no_sample_that_is_far_off_is_left_out() -> None:
    """Wrong ones behind right ones of their stamps, and a few whose stamps are 1 ns late, passed every bound."""
    times = np.arange(1000) * 10_000_000
    values = np.outer(np.sin(times * 1e-9), (1.0, 0.0, 0.0))
    good = Signal.of(times, values)
    for order in (1, -1):
        both, rows = np.append(times, times[500]), np.vstack([values, values[500] + 2.0])
        sort = np.argsort(both[::order], kind="stable")
        twice = Signal.of(both[::order][sort], rows[::order][sort])
        for a, b in ((good, twice), (twice, good)):
            found = difference("position", "world", a, b)
            assert found is not None
            assert found.max == pytest.approx(2.0 * math.sqrt(3.0))
            assert (found.first_ns, found.interpolated) == (5_000_000_000, 0)
    late, wrong = times.copy(), values.copy()
    late[500:509] += 1
    assert difference("position", "world", good, Signal.of(late, values)).max == 0.0  # type: ignore[union-attr]
    wrong[500:509] += 5.0
    for a, b in ((good, Signal.of(late, wrong)), (Signal.of(late, wrong), good)):
        found = difference("position", "world", a, b)
        assert found is not None
        assert found.max == pytest.approx(5.0 * math.sqrt(3.0), rel=1e-6)


def test_a_scene_flown_against_a_bag(log: Path, scene: Path, folder: Path) -> None:
    bag = foreign(folder / "flown.mcap", log, later_ns=LATER, commands=bag_commands())
    found = rb.compare(scene, bag, bound=1e-9)
    told = found.as_dict()
    # The commands say how the times belong together: the bag begins with its motion.
    assert (told["aligned_by"], told["offset_ns"]) == ("commands", LATER)
    assert told["first_difference_s"] is None
    assert (told["commands"], told["body"]) == ([], [])
    assert told["a"]["flown"]
    for other in (rb.compare(bag, scene), rb.compare(bag, scene=scene)):
        assert other.alignment.offset_ns == -LATER
        assert other.first_ns is None
    assert rb.compare(bag, bag, scene=scene).a.flown
    named = foreign(folder / "named.mcap", log, later_ns=LATER, commands=bag_commands("/cmd"))
    assert rb.compare(scene, named, mapping={"/cmd": "thrust"}).first_ns is None
    with pytest.raises(rb.LogError, match="--topic"):
        rb.compare(scene, named)
    spaced = foreign(folder / "spaced.mcap", log, later_ns=LATER, commands=bag_commands("/sat/thrust"))
    for found in (rb.compare(scene, spaced), rb.compare(spaced, scene)):
        assert found.first_ns is None
        assert found.commands == []


def test_commands_of_a_bag_are_compared_as_the_scene_lets_them_act(tmp_path: Path) -> None:
    """A drop at a timeout is no other command, and a bag does not say which effects act."""
    scene = rb.parse_scene(
        SCENE.replace("{topic: thrust}", "{topic: thrust, delay: 0.03, timeout: 0.4, bias: {force: [0, 0, 0.1]}}")
        + "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n"
    )
    flown = tmp_path / "flown.mcap"
    rb.simulate(scene, COMMANDS, [McapSink(flown)])
    bag = foreign(tmp_path / "bag.mcap", flown, later_ns=LATER, commands=bag_commands())
    # As that of a node, which runs until it is stopped.
    endless = rb.parse_scene(re.sub("(?m)^duration.*$", "", scene.text))
    assert endless.duration is None
    for pair in ((scene, bag), (bag, scene), (flown, bag), (endless, bag)):
        found = rb.compare(*pair)
        assert found.commands == []
    push = bag_commands()
    push[1] = (push[1][0], push[1][1], (0.0, 0.7, 0.0, -0.4, 0.1, 0.0))
    other = foreign(tmp_path / "other.mcap", flown, later_ns=LATER, commands=push)
    (told,) = rb.compare(flown, other, align="start").commands or ()
    assert told.topic == "thrust"
    assert (told.first_ns, told.force, told.torque) == (1_730_000_000, pytest.approx(0.2), 0.0)


@pytest.mark.parametrize("often", [False, True])
def test_commands_that_acted_on_arrival_do_not_differ_from_those_stamped_before(tmp_path: Path, often: bool) -> None:
    """A node takes them so by default: each "differed" from the bag beside it for less than a millisecond."""
    random = np.random.default_rng(4)
    times = 500_000_000 + np.arange(1000) * 3_000_000 if often else [wrench.stamp_ns for _, wrench in COMMANDS]
    sent = [("/thrust", int(at), tuple(random.normal(size=6).tolist())) for at in times]

    def recorded(name: str, push: list[tuple[str, int, tuple[float, ...]]]) -> Path:
        bag = foreign(tmp_path / f"stamped_{name}", flown, later_ns=LATER, commands=push)
        messages = ((m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages())
        heard = [
            (topic, kind, at + int(random.integers(300_000, 900_000)) * (topic == "/thrust"), data)
            for topic, kind, at, data in messages
        ]
        return write_rows(tmp_path / name, sorted(heard, key=lambda row: row[2]))

    flown = tmp_path / "flown.mcap"
    arrived = [
        ("thrust", rb.Wrench(push[:3], push[3:], "body", at + int(random.integers(300_000, 900_000))))
        for _, at, push in sent
    ]
    rb.simulate(rb.parse_scene(SCENE), arrived, [McapSink(flown)])
    bag = recorded("bag.mcap", sent)
    for pair in ((flown, bag), (bag, flown)):
        found = rb.compare(*pair)
        assert found.commands == []
        most_ms = max(wrench.stamp_ns - at for (_, wrench), (_, at, _) in zip(arrived, sent, strict=True)) * 1e-6
        assert any(f"nothing but when they act, by up to {most_ms:.3g} ms" in note for note in found.notes)
    # Another command, one that was lost, and one that came later.
    topic, at, push = sent[len(sent) // 2]
    rest = [each for each in sent if each[1] != at]
    for other in ([(topic, at, (*push[:5], 0.0))], [], [(topic, at + 100_000_000, push)]):
        changed = sorted([*rest, *other], key=lambda each: each[1])
        (told,) = rb.compare(flown, recorded(f"other_{len(other) and other[0][1]}.mcap", changed)).commands or ()
        assert told.topic == "thrust"


@pytest.mark.parametrize(("rate", "same"), [(20.0, True), (50.0, False)])
def test_after_a_lag_a_node_hears_commands_at_its_next_output(tmp_path: Path, rate: float, same: bool) -> None:
    """At 20 Hz, up to 50 ms and a little more after where the lag began: commands "differed"."""
    late = [("thrust", replace(wrench, stamp_ns=wrench.stamp_ns + 52_000_000)) for _, wrench in COMMANDS]
    flown = fly(tmp_path / "flown.mcap", late, output_rate=rate)
    bag = foreign(tmp_path / "bag.mcap", flown, later_ns=LATER, commands=bag_commands())
    assert (rb.compare(flown, bag, align=LATER / 1e9).commands == []) == same


def test_what_is_not_known_of_a_bag_does_not_make_the_rest_differ_on_arrival(tmp_path: Path) -> None:
    """Beside one in a frame of the log, or one that another of its time undid, commands on arrival "differed"."""
    scene = rb.parse_scene(
        SCENE.replace("{topic: thrust}", "{topic: thrust, timeout: 0.055}").replace(
            "body: {", "body: {frames: {jet: {position: [0.1, 0, 0]}}, "
        )
    )
    # In a pause of the node, the newest of those that came has acted.
    sent = [
        (0.5, "body", (1.0, 0.0, 0.0)), (1.2, "jet", (0.0, 0.5, 0.0)), (2.0, "body", (0.0, 0.7, 0.0)),
        (2.0, "body", (0.0, 0.0, 0.6)), (3.0, "jet", (0.3, 0.2, 0.0)),
    ]  # fmt: skip
    acted = [
        ("thrust", rb.Wrench(force, (0.0, 0.0, 0.1), frame, round(1e9 * at) + 400_000))
        for at, frame, force in sent[:2] + sent[3:]
    ]
    flown = tmp_path / "flown.mcap"
    rb.simulate(scene, acted, [McapSink(flown)])

    def recorded(name: str, push: list[tuple[float, str, tuple[float, ...]]]) -> Path:
        motion = open_source(foreign(tmp_path / f"motion_{name}", flown, later_ns=LATER)).messages()
        rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in motion]
        for at, frame, force in push:
            stamp = LATER + round(1e9 * at)
            data = cdr.encode(WRENCH, stamp, frame, (*force, 0.0, 0.0, 0.1))
            rows.append(("/thrust", WRENCH, stamp + 300_000, data))
        return write_rows(tmp_path / name, sorted(rows, key=lambda row: row[2]))

    found = rb.compare(flown, recorded("bag.mcap", sent))
    assert found.commands is None
    assert any("nothing but when they act, by up to 0.4 ms" in note for note in found.notes)
    other = [*sent[:3], (2.0, "body", (0.0, 0.0, 0.5)), sent[4]]
    (told,) = rb.compare(flown, recorded("other.mcap", other)).commands or ()
    assert told.topic == "thrust"


def test_commands_of_a_bag_of_a_node_in_a_namespace_act_as_its_scene_says(tmp_path: Path) -> None:
    """Neither delay and timeout of the channel were applied to them, nor was its bias left out: they "differed"."""
    channel = "{topic: thrust, delay: 0.03, timeout: 0.4, bias: {force: [0, 0, 0.1]}}"
    scene = rb.parse_scene(SCENE.replace("{topic: thrust}", channel))
    flown = tmp_path / "flown.mcap"
    rb.simulate(scene, COMMANDS, [McapSink(flown, namespace="/sat")])
    commands = [("/sat" + topic, *rest) for topic, *rest in bag_commands()]
    alone = tmp_path / "alone.mcap"
    rb.simulate(scene, COMMANDS, [McapSink(alone)])
    bag = foreign(tmp_path / "bag.mcap", alone, later_ns=LATER, commands=commands)
    for pair in ((flown, bag), (bag, flown)):
        assert rb.compare(*pair).commands == []


def test_commands_of_a_bag_beyond_the_limits_of_their_channel_are_not_known_without_the_scene(tmp_path: Path) -> None:
    """The log has what acted of them: they "differed" from what was commanded."""
    for excess in ("clip", "reject"):
        limits = f"{{topic: thrust, max_force: 0.8, on_excess: {excess}}}"
        scene = rb.parse_scene(SCENE.replace("{topic: thrust}", limits))
        flown = tmp_path / "flown.mcap"
        rb.simulate(scene, COMMANDS, [McapSink(flown)])
        bag = foreign(tmp_path / "bag.mcap", flown, later_ns=LATER, commands=bag_commands())
        found = rb.compare(flown, bag)
        assert found.commands is None
        assert any("beyond the limits" in note for note in found.notes)
        assert rb.compare(flown, bag, scene=scene).commands == []
        # What is within them is compared.
        late = [bag_commands()[0], ("/thrust", 2_000_000_000, (0.0, 0.5, 0.0, -0.4, 0.1, 0.0))]
        other = foreign(tmp_path / "other.mcap", flown, later_ns=LATER, commands=late)
        (told,) = rb.compare(flown, other).commands or ()
        assert told.first_ns == 3_100_000_000


def test_of_several_bodies_in_a_bag_that_of_the_log_is_compared(log: Path, heavier: Path, tmp_path: Path) -> None:
    """The first pose was taken, and so another body's: no lag was certain, or the motions differed."""
    flown = tmp_path / "flown.mcap"
    rb.simulate(rb.parse_scene(SCENE), COMMANDS, [McapSink(flown, namespace="/b")])
    rows = []
    for name, run in (("a", heavier), ("b", log)):
        motion = open_source(foreign(tmp_path / f"{name}.mcap", run, later_ns=LATER)).messages()
        rows += [
            (m.channel.topic.replace("/vicon", f"/{name}"), m.channel.type_name, m.log_time, m.data) for m in motion
        ]
    bag = write_rows(tmp_path / "both.mcap", sorted(rows, key=lambda row: row[2]))
    for pair in ((flown, bag), (bag, flown)):
        assert rb.compare(*pair, bound=0.0).passed
    assert not rb.compare(flown, bag, topics=TopicChoice("/a/pose", "/a/twist"), align="start", bound=0.0).passed


def test_channels_of_a_namespace_are_compared_with_those_of_their_names(log: Path, folder: Path) -> None:
    one, other = (
        foreign(
            folder / f"named{k.replace('/', '_')}.mcap",
            log,
            commands=[*bag_commands(f"{k}/thrust"), *bag_commands(f"{k}/push")],
        )
        for k in ("/sat", "")
    )
    for pair in ((one, other), (other, one)):
        found = rb.compare(*pair)
        assert found.commands == []


def test_commands_of_another_body_in_a_merged_bag_do_not_differ_from_none(tmp_path: Path) -> None:
    one, other, both = (tmp_path / f"{name}.mcap" for name in ("one", "other", "both"))
    scene = rb.parse_scene(SCENE)
    pushed = [("thrust", rb.Wrench((1.0, 0.0, 0.0), (0.0, 0.1, 0.0), "world", 500_000_000))]
    rb.simulate(scene, [], [McapSink(one, namespace="/one")])
    rb.simulate(scene, pushed, [McapSink(other, namespace="/other")])
    merge([one, other], both, (-math.inf, math.inf))
    found = rb.compare(one, both, topics=rb.TopicChoice(pose="/one/pose", twist="/one/twist"))
    assert found.commands is None


def test_effects_of_a_log_in_a_namespace_are_those_of_their_names(tmp_path: Path) -> None:
    """Some channels were remapped out of the namespace, so that names alone do not tell it."""
    scene = rb.parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: wrench}]\nduration: 2\n"
        "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]},\n"
        "  {type: scheduled_wrench, schedule: [{time: 0.5, force: [1, 0, 0]}]}]\n"
    )
    push = [("wrench", rb.Wrench((1.0, 0.0, 0.0), (0.0, 0.1, 0.0), stamp_ns=700_000_000))]
    one, other = tmp_path / "one.mcap", tmp_path / "other.mcap"
    rb.simulate(scene, push, [McapSink(one)])
    rb.simulate(scene, push, [McapSink(other, namespace="/sat", remap={"wrench": "/wrench"})])
    for pair in ((one, other), (other, one)):
        assert rb.compare(*pair).commands == []


def test_a_scene_flies_the_commands_of_a_log_in_a_namespace(tmp_path: Path) -> None:
    scene = rb.parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: wrench}]\n"
        "actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 0.1}]\nduration: 2\n"
    )
    commands: list[Any] = [
        ("wheel/command", rb.Setpoint(0.1, stamp_ns=500_000_000)),
        ("wrench", rb.Wrench((1.0, 0.0, 0.0), (0.0, 0.1, 0.0), stamp_ns=700_000_000)),
    ]
    remap = {"wheel/command": "/elsewhere"}
    for some in (commands, commands[:1]):
        rb.simulate(scene, some, [McapSink(tmp_path / "run.mcap", namespace="/sat", remap=remap)])
        found = rb.compare(scene, tmp_path / "run.mcap")
        assert found.differences["attitude"].max == found.differences["position"].max == 0.0


def test_a_log_says_from_which_bag_it_was_flown(log: Path, scene: Path, folder: Path) -> None:
    bag = foreign(folder / "source.mcap", log, later_ns=LATER, commands=bag_commands())
    run = folder / "run.mcap"
    assert main(["simulate", str(scene), "--wrench", str(bag), "--mcap", str(run)]) == 0
    found = rb.compare(run, bag)
    assert (found.alignment.by, found.alignment.offset_ns) == ("commands", LATER)
    assert found.first_ns is None
    # By what is in it: a bag that was renamed is the same, and another of its name is not.
    renamed = bag.rename(folder / "renamed.mcap")
    other = [(topic, at + 30_000_000, numbers) for topic, at, numbers in bag_commands()]
    stranger = foreign(folder / "source.mcap", log, later_ns=LATER, commands=other)
    assert rb.compare(run, renamed).alignment.by == "commands"
    assert rb.compare(run, stranger).alignment.by == "lag"


def test_commands_that_are_not_understood_are_unknown_and_a_lag_makes_no_difference(log: Path, folder: Path) -> None:
    """Ten times the torque, in a frame that nobody declared, was called the same."""
    later = [(topic, at + 1_000_000, numbers) for topic, at, numbers in bag_commands()]
    shifted = foreign(folder / "shifted.mcap", log, later_ns=LATER, commands=later)
    tracks = [read_track(read_bag(each)) for each in (log, shifted)]

    def differing(uncertainty_s: float) -> list[CommandDifference] | None:
        return command_differences(*tracks, Alignment("lag", LATER, uncertainty_s), tracks[0].span_ns)[0]

    assert differing(2e-3) == []
    assert [each.force > 1.0 for each in differing(1e-4) or ()] == [True]
    assert differing(1.0) is None
    tenfold = [(topic, at, tuple(10.0 * n for n in numbers)) for topic, at, numbers in bag_commands()]
    strange = foreign(folder / "strange.mcap", log, later_ns=LATER, commands=tenfold, frame="base_link")
    unknown = rb.compare(log, strange, align=LATER / 1e9)
    assert unknown.commands is None
    # A scene that was given and does not say it is no remedy.
    for given_scene in (None, rb.parse_scene(SCENE)):
        notes = rb.compare(log, strange, align=LATER / 1e9, scene=given_scene).notes
        (note,) = (each for each in notes if each.startswith("Not all commands on"))
        assert ("--scene" in note) == (given_scene is None)
    assert any("frames that are not declared" in note for note in unknown.notes)


def test_what_if_of_a_flight_is_aligned_and_its_commands_are_compared_as_those_of_the_flight(
    log: Path, scene: Path, folder: Path
) -> None:
    """Under the names of the bag, through the log of the flight: no lag is sought, which the inertia would shift."""
    both = [*bag_commands("/robot/cmd"), *bag_commands("/robot/other")]
    bag = foreign(folder / "robot.mcap", log, later_ns=LATER, commands=both)
    run, again, other = (folder / f"robot_{name}.mcap" for name in ("run", "again", "other"))
    mapped = ["--topic", "/robot/cmd=thrust", "--topic", "/robot/other=idle"]
    idle = ["--set", "wrenches=[{topic: thrust}, {topic: idle}]"]
    assert main(["simulate", str(scene), *idle, "--wrench", str(bag), *mapped, "--mcap", str(run)]) == 0
    assert main(["simulate", str(run), "--set", "body.inertia.matrix[0][0]=0.6", "--mcap", str(again)]) == 0
    assert main(["simulate", str(again), "--set", "body.mass=3", "--mcap", str(other)]) == 0
    for made in (run, again, other):
        found = rb.compare(made, bag)
        assert (found.alignment.by, found.alignment.offset_ns) == ("commands", LATER)
        assert found.commands == []
        found = rb.compare(bag, made)
        assert (found.alignment.offset_ns, found.commands) == (-LATER, [])


@pytest.mark.parametrize("starts", ["", "x", "1, 2", "9" * 30])
def test_times_of_bags_that_are_none_are_left_out(starts: str) -> None:
    assert origin_of({"rb_dynamics": {"wrench_bags": "a.mcap", "wrench_start_ns": starts}}) == {}


def test_bad_input_is_one_line(log: Path, scene: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    apart = foreign(folder / "apart.mcap", log, later_ns=LATER)
    for arguments in (
        [str(log)],
        [str(scene), str(scene)],
        [str(log), "nothing.mcap"],
        [str(log), str(apart), "--align", "stamp"],
        [str(log), str(log), "--from", "9"],
        [str(log), str(log), "--html", str(log)],
    ):
        assert main(["compare", *arguments]) == 2, arguments
        said = capsys.readouterr()
        assert said.out == ""
        assert "expected" in said.err or "cannot" in said.err, said.err
        assert said.err.count("\n") == 1
    for option in (["--align", "soon"], ["--bound", "-1"], ["--bound", "attitude=-1"], ["--bound", "speed=1"]):
        with pytest.raises(SystemExit) as stopped:
            main(["compare", str(log), str(log), *option])
        assert stopped.value.code == 2


def test_each_quantity_may_have_a_bound_of_its_own(
    log: Path, heavier: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = rb.compare(log, heavier).as_dict()
    most = alone["position"]["max"]
    assert rb.compare(log, heavier, bound={"attitude": 1e-9, "position": most}).passed
    found = rb.compare(log, heavier, bound={"attitude": 1e-9, "position": 0.9 * most})
    assert found.beyond == ("position",)
    with pytest.raises(ValueError, match="bound names 'speed', expected attitude or position"):
        rb.compare(log, heavier, bound={"speed": 1.0})
    with pytest.raises(ValueError, match="bound names nothing"):
        rb.compare(log, heavier, bound={})
    assert main(["compare", str(log), str(heavier), "--bound", f"attitude=1e-9,position={0.9 * most!r}"]) == 1
    assert f"BEYOND 1e-09 rad and {0.9 * most:g} m: position" in capsys.readouterr().out
    assert main(["compare", str(log), str(heavier), "--bound", "attitude=1e-9"]) == 0
    assert "attitude within 1e-09 rad" in capsys.readouterr().out


def test_a_bound_of_what_is_not_in_both_fails(log: Path, folder: Path) -> None:
    kind, twist = "geometry_msgs/msg/TwistStamped", rb.inspect(log).track.twist
    assert twist is not None
    rows = zip(twist.time_ns.tolist(), twist.values.tolist(), strict=True)
    rates = write_rows(
        folder / "rates.mcap", [("/twist", kind, at, cdr.encode(kind, at, "body", tuple(v))) for at, v in rows]
    )
    found = rb.compare(log, rates, bound={"angular_velocity": 1e-9, "position": 1.0})
    assert found.beyond == ("position",)
    assert rb.compare(log, rates, bound={"angular_velocity": 1e-9}).passed
    with pytest.raises(rb.LogError, match="expected a quantity that both have"):
        rb.compare(foreign(folder / "poses_alone.mcap", log, twist=False), rates)


def test_the_command_prints_json_text_page_and_recording(
    log: Path, heavier: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, recording = folder / "page.html", folder / "both.rrd"
    written = ["--html", str(page), "--rerun", str(recording)]
    assert main(["compare", str(log), str(heavier), "--bound", "1e-3", *written]) == 1
    out = capsys.readouterr().out
    assert "body      mass: 2 in A, 2.5 in B" in out
    assert "BEYOND 0.001: position, linear velocity" in out
    html = page.read_text()
    assert "Both motions" in html
    assert "No difference" not in html or "commands" in html
    assert recording.stat().st_size > 10_000
    assert main(["compare", str(log), str(heavier), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    keys = "aligned_by offset_s samples attitude position angular_velocity linear_velocity first_difference_s commands"
    assert {*keys.split(), "body"} <= told.keys()
    assert {"max", "rms", "at_s"} <= told["attitude"].keys()


def test_a_viewer_that_takes_nothing_is_given_up(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("rb_dynamics.sinks.rerun_sink._VIEWER_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"rerun+http://127.0.0.1:{silent.getsockname()[1]}/proxy"
        assert main(["compare", str(log), str(log), "--rerun", address]) == 2
    assert f"viewer at {address} received nothing for 0.5 s" in capsys.readouterr().err


def test_a_comparison_is_computed_before_its_recording_is_opened(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the time that it takes would count against a viewer."""
    pytest.importorskip("rerun")
    from rb_dynamics.report import comparison_rerun, comparison_text

    order: list[Any] = []

    def noted(call: Callable[[Any], Any], given: Any) -> Any:
        order.append(call)
        return call(given)

    as_text, renamed = comparison_text.as_text, comparison_rerun.renamed
    monkeypatch.setattr(comparison_text, "as_text", partial(noted, as_text))
    monkeypatch.setattr(comparison_rerun, "renamed", partial(noted, renamed))
    comparison_rerun.write_comparison_recording(rb.compare(log, log), tmp_path / "two.rrd")
    assert order == [as_text, renamed]
    assert (tmp_path / "two.rrd").stat().st_size > 5_000


@pytest.mark.parametrize("kind", ["poses", "itself", "bag"])
def test_pages_and_recordings_show_what_there_is(kind: str, log: Path, folder: Path) -> None:
    """Without momenta, without a twist or without any difference there is less to draw."""
    from rb_dynamics.report.comparison_page import comparison_report
    from rb_dynamics.report.comparison_rerun import write_comparison_recording
    from rb_dynamics.report.html import render_html

    other = log if kind == "itself" else foreign(folder / f"shown_{kind}.mcap", log, every=7, twist=kind == "bag")
    found = rb.compare(log, other, align="stamp")
    page = render_html(comparison_report(found))
    assert ("Momenta and energy" in page) == (kind == "itself")
    assert ("not in both" in page) == (kind == "poses")
    write_comparison_recording(found, folder / f"{kind}.rrd")
    assert (folder / f"{kind}.rrd").stat().st_size > 5_000


def test_the_page_shows_the_motion_of_bodies_far_from_zero(folder: Path) -> None:
    from rb_dynamics.report.comparison_page import comparison_report
    from rb_dynamics.report.html import render_html

    first, second = (fly(folder / f"far_{x:.0f}.mcap", initial__position_world=[x, 2e6, 0.0]) for x in (1e6, 1e6 + 2.0))
    page = render_html(comparison_report(rb.compare(first, second, align="stamp")))
    assert "Position of the body origin less (1000000, 2000000, 0) m, world axes [m]" in page


def test_a_body_that_was_moved_is_told_as_a_cause(folder: Path, log: Path) -> None:
    scene = rb.parse_scene(SCENE, "test.yaml")
    run = rb.Simulation(scene, [McapSink(folder / "moved.mcap")])
    run.start()
    for topic, wrench in COMMANDS:
        run.post(topic, wrench, wrench.stamp_ns)
    run.advance(2_000_000_000)
    run.set_state(StateChange.to(rb.State(0, angular_velocity_body=(0.1, 0.2, 0.3)), scene.body).at(2_000_000_000))
    run.advance(4_000_000_000)
    run.finish()
    found = rb.compare(log, folder / "moved.mcap")
    told = [note for note in found.notes if "set_state" in note]
    assert told == ["B was moved to another state (set_state) at t = 2 s: the motions differ from then on in any case"]


@pytest.mark.parametrize("swapped", [False, True])
def test_the_new_state_with_the_stamp_of_the_old_one_is_no_difference(folder: Path, swapped: bool) -> None:
    """A node that stands still shows the state to which it was moved at once; its log has it on set_state only."""
    scene, path = rb.parse_scene(SCENE, "test.yaml"), folder / f"moved_{swapped}.mcap"
    run = rb.Simulation(scene, [McapSink(path)])
    run.start()
    run.advance(2_000_000_000)
    run.set_state(StateChange.to(rb.State(0, (1.0, 0.0, 0.0)), scene.body).at(2_000_000_000))
    run.advance(4_000_000_000)
    run.finish()
    own, bag = (read_track(read_bag(each)) for each in (path, foreign(folder / f"seen_{swapped}.mcap", path)))
    assert bag.pose is not None
    at = int(bag.pose.time_ns.searchsorted(2_000_000_000))
    shown = np.insert(bag.pose.values, at + 1, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], axis=0)
    pose = replace(bag.pose, time_ns=np.insert(bag.pose.time_ns, at, 2_000_000_000), values=shown)
    flights = [Given(own, "own"), Given(replace(bag, pose=pose), "bag")]
    found = compare_tracks(*flights[:: -1 if swapped else 1], Alignment("stamp", 0))
    assert all(found.differences[name].first_ns is None for name in MOTION)
    assert any("unless the other was so, too" in note for note in found.notes)
    assert not any("set_state" in note for note in rb.compare(folder / "moved.mcap", folder / "moved.mcap").notes)


def test_a_scene_without_duration_flies_as_long_as_a_bag_without_commands_whatever_its_clock(folder: Path) -> None:
    bag = foreign(folder / "dated.mcap", fly(folder / "free.mcap", []), later_ns=LATER)
    found = rb.compare(rb.parse_scene(SCENE.replace("duration: 4.0\n", "")), bag, align="start")
    assert found.differences["attitude"].max < 1e-9
    assert found.share == pytest.approx(1.0)
