"""Runs written to .rrd files, and the content of those files by Rerun's own reader."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import IDENTITY, State
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.numerics import rotation
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.sink import Event, RunInfo
from rb_dynamics.scene.model import Channel, Scene, Solver
from rb_dynamics.sinks.rerun_sink import RerunSink

INDEXES = ("rerun.controls.RowId", "sim_time", "sample")
BODY = RigidBody.from_principal(2.0, (1.0, 2.0, 2.5), rotation.exp((0.3, 0.2, 0.1)), (0.1, -0.2, 0.05))
SCENE = Scene(
    BODY,
    WrenchFrames(center_of_mass=BODY.center_of_mass),
    State(0, (1.0, 2.0, 3.0), IDENTITY, linear_velocity_world=(0.5, 0.0, -0.1), angular_velocity_body=(0.1, 2.0, 0.1)),
    channels=(Channel("wrench"), Channel("other")),
    solver=Solver("rk4", 0.005, None),
    duration=3.0,
    output_rate=100.0,
    text="body: {mass: 2}\n",
    source="config/tumble.yaml",
)
COMMANDS = (
    ("wrench", Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.5), "body", 505_000_000)),
    ("wrench", Wrench((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), "world", 1_000_000_000)),
    ("wrench", Wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "world", 2_000_000_000)),
)


@dataclass
class Memory:
    """Keeps all events."""

    events: list[Event] = field(default_factory=list)

    def open(self, run: RunInfo) -> None:
        self.events.clear()

    def write(self, event: Event) -> None:
        self.events.append(event)

    def close(self, result: Mapping[str, str]) -> None:
        pass

    @property
    def samples(self) -> list[Sample]:
        return [event for event in self.events if isinstance(event, Sample)]


class Rrd:
    """A .rrd file as Rerun reads it: rows (time_ns, sample, value) of a component, times None for static ones."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        self.reader = RrdReader(path)
        self.rows: dict[tuple[str, str], list[tuple[int | None, int | None, list[object]]]] = defaultdict(list)
        self.batches = 0
        for chunk in self.reader.stream().to_chunks():
            batch = chunk.to_record_batch()
            self.batches += chunk.entity_path == "/position"
            times, samples = ([None] * chunk.num_rows, [None] * chunk.num_rows)
            if not chunk.is_static:
                times, samples = (batch.column(name).cast("int64").to_pylist() for name in ("sim_time", "sample"))
            for name in (name for name in batch.schema.names if name not in INDEXES):
                rows = zip(times, samples, batch.column(name).to_pylist(), strict=True)
                self.rows[chunk.entity_path, name] += [row for row in rows if row[2] is not None]
        for rows in self.rows.values():
            rows.sort(key=lambda row: -1 if row[1] is None else row[0])

    def times(self, entity: str, component: str = "Scalars:scalars") -> list[int]:
        return [row[0] for row in self.rows["/" + entity, component]]

    def indices(self, entity: str, component: str = "Scalars:scalars") -> list[int]:
        return [row[1] for row in self.rows["/" + entity, component]]

    def values(self, entity: str, component: str = "Scalars:scalars") -> np.ndarray:
        return np.array([row[2] for row in self.rows["/" + entity, component]])

    def static(self, entity: str, component: str) -> list[object]:
        return [row for row in self.rows["/" + entity, component] if row[0] is None][-1][2]


def logged(tmp_path: Path, scene: Scene = SCENE, commands=COMMANDS, **options: int) -> tuple[Rrd, list[Sample]]:
    path, memory = tmp_path / "run.rrd", Memory()
    simulate(scene, commands, [RerunSink(path, **options), memory])
    return Rrd(path), memory.samples
