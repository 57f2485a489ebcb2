"""`--from` and `--to`: a part of a recording, inspected, converted or compared."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from foreign_flights import foreign
from recorded_runs import Flight, flight

import rb_dynamics as rb
from rb_dynamics.cli import main
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.sinks.mcap_sink import McapSink

__all__ = ["flight"]

LATER = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def rows(table: Path) -> list[dict[str, str]]:
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_part_of_a_log_is_inspected_with_what_was_held(flight: Flight) -> None:
    # The force that holds over the whole part came before it.
    found = rb.inspect(flight.log, window_s=(1.1, 2.0))
    assert found.passed, [check for check in found.summary.checks if not check.passed]
    assert (found.summary.samples, found.summary.start_ns) == (46, 1_100_000_000)
    assert found.summary.clock == "t is simulation time"
    momentum = found.summary.balance("linear momentum")
    assert momentum is not None
    assert momentum.covered == 1.0
    assert momentum.relative < 1e-13
    whole = rb.inspect(flight.log, window_s=(None, None))
    assert whole.as_dict() == rb.inspect(flight.log).as_dict()


def test_a_part_of_a_bag_counts_from_the_start_of_its_motion(flight: Flight, tmp_path: Path) -> None:
    commands = [("/thrust", 0, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))]
    bag = foreign(tmp_path / "bag.mcap", flight.log, later_ns=LATER, commands=commands)
    found = rb.inspect(bag, window_s=(0.5, 1.5))
    assert (found.summary.samples, found.summary.start_ns) == (51, LATER + 500_000_000)
    assert len(found.track.wrenches[0].time_ns) == 1


def test_findings_in_a_part_have_the_times_of_the_whole(flight: Flight, tmp_path: Path) -> None:
    bag = foreign(tmp_path / "bag.mcap", flight.log, later_ns=LATER, without=[(1.0, 1.6)])
    whole, part = (rb.inspect(bag, window_s=(start_s, None)).summary for start_s in (None, 0.5))
    assert part.clock == f"t counts from the start of the whole recording, at header.stamp {LATER // 10**9}.000000000 s"
    for told in (whole, part):
        (gap,) = {check.detail for check in told.checks if "gap" in check.detail}
        assert gap == "1 gap: 0.6 s from t = 1 s"
        assert {topic.longest_at_s for topic in told.topics if topic.count} == {1.0}
    assert part.moments == rb.inspect(bag, window_s=(0.5, 3.0)).summary.moments
    assert part.ranges[0].low_at_s >= 0.5


def test_a_part_is_converted(flight: Flight, tmp_path: Path) -> None:
    table = tmp_path / "part.csv"
    assert main(["convert", str(flight.log), str(table), "--from", "0.6", "--to", "2"]) == 0
    times = [int(row["time_ns"]) for row in rows(table)]
    assert (times[0], times[-1], len(times)) == (600_000_000, 2_000_000_000, 71)
    commands = [int(row["time_ns"]) for row in rows(tmp_path / "part.wrenches.csv")]
    assert commands == [700_000_000, 1_000_000_000]
    bag = foreign(tmp_path / "bag.mcap", flight.log, later_ns=LATER)
    assert main(["convert", str(bag), str(table), "--from", "2.9"]) == 0
    stamps = [int(row["stamp_ns"]) - LATER for row in rows(table) if row["type"].endswith("PoseStamped")]
    assert stamps == [2_900_000_000 + 20_000_000 * k for k in range(6)]


def test_a_part_is_a_bag_with_what_was_held(flight: Flight, tmp_path: Path) -> None:
    """The force that holds over the whole part came before it: it was said that no inertia explains the motion."""
    part = tmp_path / "part.mcap"
    assert main(["convert", str(flight.log), str(part), "--from", "1.1", "--to", "2"]) == 0
    found = rb.inspect(part)
    assert found.passed, [check for check in found.summary.checks if not check.passed]
    assert found.summary.samples == 46
    compared = rb.compare(flight.log, part)
    assert compared.commands == []


@pytest.mark.parametrize("half_seconds", [3, 1])
def test_the_run_of_a_part_begins_with_it(flight: Flight, tmp_path: Path, half_seconds: int) -> None:
    """Not with the command before it, which is held; of one less than 1 s older it did."""
    cut_ns = half_seconds * SECOND // 2
    commands = [("/thrust", k * SECOND, (float(k), 0.0, 0.0, 0.0, 0.0, 0.0)) for k in (0, 2)]
    bag = foreign(tmp_path / "bag.mcap", flight.log, later_ns=LATER, commands=commands)
    part = tmp_path / "part.mcap"
    assert main(["convert", str(bag), str(part), "--from", str(cut_ns / SECOND)]) == 0
    found = RecordedWrenches([part], ["thrust"], 10 * SECOND, start="auto")
    assert [(wrench.stamp_ns, wrench.force[0]) for _, wrench in found] == [(-cut_ns, 0.0), (2 * SECOND - cut_ns, 2.0)]


def test_a_part_is_shown(flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(flight.log), str(tmp_path / "part.rrd"), "--from", "1.1", "--to", "1.2"]) == 0
    assert "6 rows" in capsys.readouterr().out


def test_a_time_outside_is_one_line(flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (
        ["inspect", str(flight.log), "--from", "9"],
        ["inspect", str(flight.log), "--from", "2", "--to", "1"],
        ["compare", str(flight.log), str(flight.log), "--from", "9"],
        ["convert", str(flight.log), str(tmp_path / "x.csv"), "--from", "2", "--to", "1"],
    ):
        assert main(arguments) == 2, arguments
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.count("\n") == 1
        assert "expected" in said.err
    with pytest.raises(SystemExit) as stopped:
        main(["convert", str(flight.log), str(tmp_path / "x.yaml"), "--from", "1"])
    assert stopped.value.code == 2


@pytest.mark.parametrize(
    ("channel", "effects", "name"),
    [
        ("{topic: push}", "[{type: linear_drag, rotation: [0.1, 0.1, 0.1]}]", "linear_drag"),
        ("{topic: push, lag: 0.4}", "[]", "push/lag"),
    ],
)
def test_what_no_topic_of_a_log_says_is_not_known_in_a_bag_made_of_it(
    tmp_path: Path, channel: str, effects: str, name: str
) -> None:
    """It was said that no inertia explains the motion."""
    scene = rb.parse_scene(f"""
body: {{mass: 2, inertia: {{diagonal: [0.2, 0.3, 0.4]}}}}
initial: {{angular_velocity_body: [0.3, -0.4, 0.5]}}
wrenches: [{channel}]
effects: {effects}
duration: 3
output_rate: 50
""")
    log, part = tmp_path / "run.mcap", tmp_path / "part.mcap"
    rb.simulate(scene, [("push", rb.Wrench(torque=(0.1, 0.0, 0.0), stamp_ns=SECOND // 2))], [McapSink(log)])
    assert main(["convert", str(log), str(part), "--from", "1"]) == 0
    found = rb.inspect(part)
    assert found.passed, [check for check in found.summary.checks if not check.passed]
    (check,) = (each for each in found.summary.checks if each.name == "inertia explains the motion")
    assert not check.judged
    assert f"the force and torque of {name} are in no topic" in check.detail
