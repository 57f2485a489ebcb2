"""Runs and bags for tests of analysis and report, written by the simulation and by the mcap package."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from rb_dynamics.formats import cdr
from rb_dynamics.formats.message_definitions import schema_text
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.run.simulate import Run, simulate
from rb_dynamics.scene import parse_scene
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.memory_sink import MemorySink

SCENE = """
body:
  mass: 4.0
  center_of_mass: [0.1, -0.2, 0.05]
  inertia: {matrix: [[0.5, 0.02, -0.01], [0.02, 0.7, 0.03], [-0.01, 0.03, 0.9]]}
initial: {angular_velocity_body: [0.3, -0.4, 0.5], linear_velocity_world: [0.1, 0, -0.2]}
wrenches:
  - {topic: thrust, timeout: 0.35}
  - {topic: push}
solver: {method: rkmk4, step: 0.01}
duration: 3.0
output_rate: 50.0
"""

COMMANDS = (
    ("thrust", Wrench((0.0, 0.0, 0.0), (0.2, -0.1, 0.3), "body", 500_000_000)),
    ("thrust", Wrench((0.0, 0.0, 0.0), (-0.1, 0.1, 0.0), "body", 700_000_000)),
    ("push", Wrench((1.0, -2.0, 0.5), (0.0, 0.0, 0.0), "world", 1_000_000_000)),
    ("push", Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "world", 2_250_000_000)),
)

Row = tuple[str, str, int, tuple[Any, ...]]
Bagger = Callable[[Iterable[Row]], Path]


@dataclass(frozen=True)
class Flight:
    """A run: its log, its samples and what `simulate` returned."""

    log: Path
    samples: MemorySink
    result: Run


def fly(path: Path, text: str = SCENE, commands: Iterable[tuple[str, Wrench]] = COMMANDS) -> Flight:
    samples = MemorySink()
    result = simulate(parse_scene(text, "test.yaml"), commands, [McapSink(path), samples])
    return Flight(path, samples, result)


@pytest.fixture
def flown(tmp_path: Path) -> Callable[..., Flight]:
    """Return a function that runs the scene after replacing parts of its text, with these commands."""

    def run(commands: Iterable[tuple[str, Wrench]] = COMMANDS, **replaced: str) -> Flight:
        text = SCENE
        for key, value in replaced.items():
            text = re.sub(rf"{key}: [0-9.]+", f"{key}: {value}", text)
        return fly(tmp_path / "run.mcap", text, commands)

    return run


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Return a run with torques in body axes that time out, and a force in world axes."""
    return fly(tmp_path_factory.mktemp("flight") / "run.mcap")


@pytest.fixture(scope="session")
def coasting(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Return the same body with nothing acting on it."""
    return fly(tmp_path_factory.mktemp("coasting") / "run.mcap", commands=())


@pytest.fixture
def bagger(tmp_path: Path) -> Bagger:
    """Return a function that writes messages (topic, type, log time, values) as a bag of another writer."""

    def write(rows: Iterable[Row]) -> Path:
        from mcap.writer import Writer

        path = tmp_path / "foreign.mcap"
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start("ros2", "test")
            for topic, type_name, time_ns, values in rows:
                if type_name not in schemas:
                    text = schema_text(type_name).encode()
                    schemas[type_name] = writer.register_schema(type_name, "ros2msg", text)
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "cdr", schemas[type_name])
                writer.add_message(channels[topic], time_ns, cdr.encode(type_name, *values), time_ns)
            writer.finish()
        return path

    return write
