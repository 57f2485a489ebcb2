"""The hash of the inputs can be recomputed from a log alone, by the rules in the reference."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path

from rb_dynamics import Wrench, parse_scene, simulate
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink

SCENE = parse_scene(
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push, timeout: 0.1}, {topic: /turn}]\n"
    "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n"
    "solver: {method: rkmk4, step: 0.1}\nduration: 1\n"
)


def test_it_is_what_the_reference_says(tmp_path: Path) -> None:
    commands = [
        ("turn", Wrench((0.0, -0.0, 5e-324), (1.0, 2.0, 1 / 3), "world", 0)),
        ("push", Wrench((1e100, 0.0, 0.0), stamp_ns=0)),
        ("push", Wrench((0.0, 0.0, 1.0), stamp_ns=0)),
        ("push", Wrench((float("inf"), 0.0, 0.0), stamp_ns=7)),
        ("push", Wrench((0.0, 1.0, 0.0), stamp_ns=500_000_000)),
    ]
    simulate(SCENE, commands, [McapSink(tmp_path / "run.mcap", namespace="/sat")])
    bag = read_bag(tmp_path / "run.mcap")
    told = [
        (time_ns, place, topic, wrench)
        for place, topic in enumerate(("push", "/turn"))
        for time_ns, wrench in bag.wrenches(bag.metadata["rb_dynamics.topics"][topic])
        if abs(wrench.force[0]) < float("inf")
    ]
    expected = hashlib.sha256(bag.attachments["scene.yaml"])
    for time_ns, _, topic, w in sorted(told, key=lambda each: each[:2]):
        numbers = struct.pack("<6d", *w.force, *w.torque).hex()
        expected.update(f"{time_ns} {topic} {w.stamp_ns} {numbers} {w.frame_id}\n".encode())
    result = bag.metadata["rb_dynamics.result"]
    assert len(told) == 4
    assert (result["inputs_sha256"], result["inputs_rule"]) == (expected.hexdigest(), "2")
