"""Latencies of commands from a log."""

from __future__ import annotations

from pathlib import Path

import pytest

from rb_dynamics import Simulation, parse_scene
from rb_dynamics.analysis.latency import command_latencies
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.report.inspection_text import histogram
from rb_dynamics.run.sink import Latency
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = "body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}\nwrenches: [{topic: wrench}]\nduration: 0.1\n"


def test_a_command_that_acts_from_before_it_was_sent_is_not_counted_as_a_short_way(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    simulation = Simulation(parse_scene(SCENE), [McapSink(log)])
    simulation.start()
    # Sent at 10 ms, received 1 ms later; they act at 8, 9.5, 10.1 and 200 ms.
    for number, acted_ns in enumerate((8_000_000, 9_500_000, 10_100_000, 200_000_000)):
        simulation.write(Latency(0, "wrench", 10_000_000, 11_000_000, acted_ns, number))
    simulation.advance(100_000_000)
    simulation.finish()
    (latency,) = command_latencies(read_bag(log))
    assert latency.waiting_s == pytest.approx(-0.0012)
    lines = histogram(latency)
    assert [line.split("  ")[2].strip() for line in lines[1:3]] == ["below 0 ms", "0 to 0.2 ms"]
    assert lines[1].split()[3] == "2"
    assert lines[2].split()[4] == "1"
    assert lines[-2].split()[:4] == ["from", "100", "ms", "1"]
