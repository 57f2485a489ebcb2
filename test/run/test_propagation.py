"""Many edges in one call of a kernel give the bits and events of one edge at a time."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_rows import STAMPED, write_rows
from edited_logs import edited
from rerun_runs import Rrd

from rb_dynamics import Solver, Wrench, parse_scene, simulate
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import Message
from rb_dynamics.logs.wrench_bags import RecordedWrenches
from rb_dynamics.motion import METHODS, arc, propagation
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by, dense_kernel
from rb_dynamics.motion.kernel_layout import phase_of
from rb_dynamics.motion.taylor import TAYLOR
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulation import Simulation, without_outputs
from rb_dynamics.run.sink import RunInfo
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.failure_guard import GuardedSink
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.memory_sink import MemorySink
from rb_dynamics.sinks.rerun_sink import RerunSink
from rb_dynamics.sinks.state_hash import HashSink
from rb_dynamics.study.replay import replay

pytest.importorskip("numba")
pytest.importorskip("mcap")

SCENE = parse_scene("""
body:
  mass: 2.5
  center_of_mass: [0.1, -0.2, 0.05]
  inertia: {matrix: [[1.0, 0.1, 0], [0.1, 1.7, -0.2], [0, -0.2, 2.0]]}
  frames: {nozzle: {position: [0.3, 0, 0], orientation: {x: 0.5, y: -0.5, z: 0.5, w: 0.5}}}
initial: {angular_velocity_body: [0.3, 0.8, -0.2], linear_velocity_world: [0.1, 0, 0.2]}
wrenches: [{topic: a, timeout: 0.03}, {topic: b, max_force: 3.0, on_excess: clip}]
duration: 3.0
output_rate: 70
""")


EFFECTS = """
effects:
  - {type: central_gravity, gravitational_parameter: 3.0, center_world: [4, 1, -2], gravity_gradient: true}
  - {type: quadratic_drag, translation: 0.05, rotation: 0.02}
  - {type: rotor, axis_body: [0, 1, 0], axial_inertia: 0.02, spin_rate: [{time: 0.5, rate: 0}, {time: 1.7, rate: 60}]}
"""


class _Everything:
    """Records all events, and the acceleration at each sample."""

    def open(self, run: RunInfo) -> None:
        self.events: list[Any] = []
        self.result: Any = None
        assert run.acceleration is not None
        self._acceleration = run.acceleration

    def write(self, event: Any) -> None:
        self.events.append((event, self._acceleration() if isinstance(event, Sample) else None))

    def close(self, result: Any) -> None:
        self.result = dict(result)


@pytest.fixture(autouse=True)
def _compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of edges that each call of the propagation kernel takes from now on."""
    flown: list[int] = []
    whole = propagation.propagate

    def counted(*arguments: Any) -> Any:
        found = whole(*arguments)
        flown.append(0 if found is None else found.edges)
        return found

    monkeypatch.setattr("rb_dynamics.run.plan.propagate", counted)
    return flown


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Commands in and out of order, early and late, at equal times, too large, unknown, and zero for a while."""
    r = random.Random(5)
    rows: list[Any] = []
    for k in range(500):
        at = r.choice([k * 6_000_000, r.randrange(-10_000_000, 3_100_000_000), (k // 7) * 40_000_000])
        size = {0: 4.0, 13: 1e200, 26: float("nan")}.get(k % 40, 0.5)
        force = [size * r.uniform(-1.0, 1.0) for _ in range(6)] if k % 9 else [0.0] * 6
        frame = r.choice(["", "body", "world", "nozzle", "nowhere" if k % 100 == 0 else "world"])
        rows.append((r.choice(["/a", "/b"]), STAMPED, max(0, at) + 5, _command(at, force, frame)))
    return write_rows(tmp_path_factory.mktemp("bag") / "commands.mcap", rows)


def _command(stamp_ns: int, numbers: list[float], frame: str = "body") -> bytes:
    return cdr.encode(STAMPED, stamp_ns, frame, numbers)


def _run(scene: Scene, commands: Any, *sinks: Any) -> Any:
    return simulate(scene, commands, sinks)


def _singly(scene: Scene, commands: Any, *sinks: Any) -> Any:
    """Post commands one by one, and go from edge to edge without the kernel."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("simulation", "posting"):
            patch.setattr(f"rb_dynamics.run.{module}.FEWEST", 10**9)
        return simulate(scene, list(commands), sinks)


@pytest.mark.parametrize(
    "solver",
    [
        Solver(method="auto", accuracy=1e-7),
        Solver(method="auto", step=0.01),
        Solver(method="rk4", step=1 / 256),
        Solver(method="rk4", accuracy=1e-5),
        Solver(method="dop853", accuracy=1e-9),
        Solver(method="taylor", accuracy=1e-9),
    ],
    ids=str,
)
def test_a_bag_flies_as_its_commands_one_by_one(bag: Path, solver: Solver, flown: list[int]) -> None:
    scene = replace(SCENE, solver=solver)
    recorded = RecordedWrenches([bag], ["a", "b"], scene.end_ns or 0)
    singly, together = _Everything(), _Everything()
    one = _singly(scene, recorded, singly)
    assert not flown
    listed = _Everything()
    _run(scene, list(recorded), listed)
    assert repr(listed.events) == repr(singly.events)
    alone = sum(flown)
    all_at_once = _run(scene, recorded, together)
    assert repr(singly.events) == repr(together.events)
    assert singly.result == together.result
    assert (one.steps, one.method, one.clipped) == (all_at_once.steps, all_at_once.method, all_at_once.clipped)
    assert sorted(one.rejected) == sorted(all_at_once.rejected)
    unseen = _run(scene, recorded)
    assert (unseen.sample, unseen.steps, unseen.method) == (one.sample, one.steps, one.method)
    # Of some 600 edges, all but those beside a command that has to be checked by itself.
    assert min(alone, sum(flown) - alone) > 300


@pytest.mark.parametrize(
    "solver",
    [
        Solver(method="rk4", step=1 / 256),
        pytest.param(Solver(method="dop853", accuracy=1e-9), marks=pytest.mark.slow),
        Solver(method="auto", accuracy=1e-7),
    ],
    ids=str,
)
def test_so_it_does_under_effects(bag: Path, solver: Solver, flown: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bits of plain Python, across the knots of a rotor, with its energy and the potential in the books."""
    scene = replace(parse_scene(SCENE.text + EFFECTS), solver=solver)
    recorded, kept = RecordedWrenches([bag], ["a", "b"], scene.end_ns or 0), []
    for when, fly in (("never", _singly), ("always", _singly), ("always", _run)):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        flown.clear()
        everything = _Everything()
        run = fly(scene, recorded, everything)
        kept.append((repr(everything.events), everything.result, run.steps, run.method, sorted(run.rejected)))
    assert kept[0] == kept[1] == kept[2]
    assert sum(flown) > 300


def test_a_method_is_chosen_again_in_long_arcs_after_a_coast_too(flown: list[int]) -> None:
    """A burst leads to the method for short arcs; of two long ones with a coast between, both have a better one."""
    scene = replace(SCENE, solver=Solver(method="auto", accuracy=1e-7), duration=220.0, output_rate=1.0)
    burst = [(k * 1_000_000, (0.1, 0.2, 0.3 * (-1) ** k)) for k in range(5)]
    torques = [*burst, (10_000_000, (0.02, 0, 0.01)), (100_000_000_000, (0, 0, 0)), (110_000_000_000, (0, 0.01, 0.02))]
    commands = [("b", Wrench((0.0, 0.0, 0.0), torque, "body", at)) for at, torque in torques]
    one, together = _singly(scene, commands, HashSink()), _run(scene, commands, HashSink())
    assert (together.sample, together.steps, together.method) == (one.sample, one.steps, one.method)
    assert sum(flown) > 100


@pytest.mark.parametrize("first", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)])
@pytest.mark.parametrize("bursts", [5, 0])
def test_commands_of_one_time_that_come_one_by_one_fly_as_together(first: tuple[float, ...], bursts: int) -> None:
    """Also where the first of them lets the body coast, or is the first that drives it."""
    scene = replace(SCENE, solver=Solver(method="auto", accuracy=1e-7), duration=10.0)
    burst = [(k * 1_000_000, (0.1, 0.2, 0.3 * (-1) ** k)) for k in range(bursts)]
    then = 5_000_000_000 if bursts else 200_000_000
    torques = [*burst, (10_000_000 * (bursts > 0), (0.02 * bursts, 0, 0)), (then, first), (then, (0, 0.01, 0.02))]
    commands = [(Wrench((0.0, 0.0, 0.0), torque, "body", at), at) for at, torque in torques]
    found = []
    for waits in (False, True):
        run = Simulation(scene, [])
        run.start()
        for wrench, at_ns in commands:
            if waits:
                run.advance(at_ns)
            run.post("b", wrench, at_ns)
        run.advance(scene.end_ns or 0)
        found.append((run.sample, run.steps, run.methods))
        run.finish()
    assert found[0] == found[1]


@pytest.mark.parametrize(("gravity", "rate"), [(False, 300.0), (True, 300.0), (False, 0.5)])
def test_sinks_that_take_blocks_keep_what_they_keep_of_single_events(
    bag: Path, tmp_path: Path, gravity: bool, rate: float
) -> None:
    """To the byte of the log: messages, order, chunks, index, checkpoints, hashes; blocks without samples, too."""
    effects = "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n" if gravity else ""
    scene = replace(parse_scene(SCENE.text + effects), solver=Solver(method="rk4", step=1 / 64), output_rate=rate)
    recorded, kept = RecordedWrenches([bag], ["a", "b"], scene.end_ns or 0), []
    for name, fly in (("singly", _singly), ("together", _run)):
        log, states, memory = McapSink(tmp_path / name, settings=LogSettings(flush_s=0.0)), HashSink(), MemorySink()
        fly(scene, recorded, log, GuardedSink(states, print), memory)
        arrays = [getattr(memory, field.name).tolist() for field in fields(Sample)]
        kept.append((log.path.read_bytes(), states.hexdigest(), repr([memory.samples, memory.applied, arrays])))
    assert len(kept[0][0]) > (400_000 if rate > 1.0 else 10_000)
    assert kept[0] == kept[1]


@pytest.mark.parametrize(
    ("rate", "max_rows"), [(300.0, 100_000), pytest.param(300.0, 100, marks=pytest.mark.slow), (0.5, 100_000)]
)
def test_a_recording_by_blocks_has_the_rows_of_one_by_events(
    bag: Path, tmp_path: Path, rate: float, max_rows: int
) -> None:
    pytest.importorskip("rerun")
    scene = replace(SCENE, solver=Solver(method="rk4", step=1 / 64), output_rate=rate)
    recorded, kept = RecordedWrenches([bag], ["a", "b"], scene.end_ns or 0), []
    for name, fly in (("singly", _singly), ("together", _run)):
        path = tmp_path / f"{name}.rrd"
        fly(scene, recorded, RerunSink(path, max_rows=max_rows, batch_rows=200, follow_s=1e9))
        # What is not of a time is sent anew with every batch; the last one counts.
        kept.append({name: rows[-1:] if rows[0][0] is None else rows for name, rows in Rrd(path).rows.items()})
        del kept[-1]["/__properties", "RecordingInfo:start_time"]
    assert kept[0].keys() == kept[1].keys()
    assert [name for name in kept[0] if repr(kept[0][name]) != repr(kept[1][name])] == []


@pytest.mark.slow
def test_a_replay_by_blocks_finds_what_one_by_events_finds(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a log as it was written, and where each kind of message was changed or left out."""
    scene = parse_scene(SCENE.text + "solver: {method: rk4, step: 0.015625}\n")
    log = tmp_path / "run.mcap"
    _run(scene, RecordedWrenches([bag], ["a", "b"], scene.end_ns or 0), McapSink(log))
    assert replay(log).identical

    def changed(message: Message, topic: str) -> Message | None:
        if message.channel.topic != topic or message.log_time < 1_000_000_000:
            return message
        return None if message.log_time > 2_900_000_000 else message._replace(data=message.data[:-3] + b"\x01\x40\x40")

    for topic in ("/pose", "/energy/work", "/a", "/b/applied"):
        broken = edited(log, tmp_path / "edited.mcap", lambda message, topic=topic: changed(message, topic))
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "always")
        by_blocks = replay(broken)
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
        assert by_blocks == replay(broken)
        assert topic in by_blocks.differences or by_blocks.missing


def test_a_propagation_that_cannot_go_on_ends_at_the_last_good_state_with_all_of_its_events(tmp_path: Path) -> None:
    rows: list[Any] = [
        ("/a", STAMPED, k * 10**7, _command(k * 10**7, [0.1, 0, 0, 0, 2e4 if k > 60 else 0.1, 0])) for k in range(200)
    ]
    scene = replace(SCENE, solver=Solver(method="rk4", step=0.01))
    recorded = RecordedWrenches([write_rows(tmp_path / "a.mcap", rows)], ["a", "b"], scene.end_ns or 0)
    kept = []
    for fly in (_singly, _run):
        sink = _Everything()
        with pytest.raises(ConvergenceError) as error:
            fly(scene, recorded, sink)
        kept.append((sink.events, sink.result, str(error.value)))
    assert kept[0] == kept[1]
    assert len(kept[0][0]) > 60


def test_a_closed_form_between_two_driven_arcs_is_named(tmp_path: Path) -> None:
    """The log names the method used in the middle of a propagation, not only those at its ends."""
    rows: list[Any] = [
        ("/b", STAMPED, k * 10**7, _command(k * 10**7, [0.0] * 6 if 100 <= k < 200 else [0.1, 0, 0, 0.02, 0.01, 0.03]))
        for k in range(300)
    ]
    recorded = RecordedWrenches([write_rows(tmp_path / "a.mcap", rows)], ["a", "b"], SCENE.end_ns or 0)
    one, together = _singly(SCENE, recorded), _run(SCENE, recorded)
    assert one.method == together.method
    assert "exact" in one.method
    assert (one.sample, one.steps) == (together.sample, together.steps)


def test_a_coast_with_outputs_is_flown_in_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = replace(SCENE, channels=(), duration=20.0)
    flown, edge_by_edge = _Everything(), _Everything()
    first = _run(scene, (), flown)
    monkeypatch.setattr("rb_dynamics.run.plan.propagate", lambda *_: None)
    second = _run(scene, (), edge_by_edge)
    assert flown.events == edge_by_edge.events
    assert (first.sample, first.steps, first.method) == (second.sample, second.steps, second.method)


def test_commands_that_come_meanwhile_are_heeded() -> None:
    """A run that is advanced piece by piece, with commands in between, as in the node."""
    from rb_dynamics.run.simulation import Simulation

    runs = []
    for piece in (3_000_000_000, 500_000_000, 70_000_001):
        sink = _Everything()
        run = Simulation(replace(SCENE, solver=Solver(method="dop853", accuracy=1e-8)), [sink])
        run.start()
        for at in _times(piece):
            run.advance(at)
            if at == 2_100_000_030:
                run.post("b", Wrench((1.0, 0.0, 0.2), (0.0, 0.1, 0.0)), at)
        run.finish()
        runs.append((sink.events, sink.result))
    assert runs[0] == runs[1] == runs[2]


def _times(piece: int) -> Iterator[int]:
    times = {*range(piece, 3_000_000_000, piece), 2_100_000_030, 3_000_000_000}
    yield from sorted(times)


GRAVITY = EFFECTS.replace("quadratic_drag, translation: 0.05", "linear_drag, translation: 0.03")
BUOYED = """
effects:
  - {type: buoyancy, volume: 0.002, density: 1025, acceleration_world: [0, 0, -9.8], center_body: [0.1, 0, 0.1]}
"""


@pytest.mark.parametrize(("method", "steps"), [("rk4", 101), ("dop853", 101), ("taylor", 100), ("auto", None)])
def test_under_regular_commands_one_stride_leads_to_the_next(method: str, steps: int | None, flown: list[int]) -> None:
    """So no time is spent on trials of longer ones; the first after them is as long, and the bits are the same."""
    period = 10_000_000
    scene = replace(SCENE, solver=Solver(method=method, accuracy=1e-6))
    commands = [("b", Wrench((0.1, 0.0, 0.2), (0.1, 0.01 * k, -0.2), "body", period * k)) for k in range(100)]
    singly, together = _Everything(), _Everything()
    one = _singly(scene, commands, singly)
    assert not flown
    many = _run(scene, commands, together)

    assert sum(flown) > 100
    assert repr(together.events) == repr(singly.events)
    assert (many.sample, many.steps, many.method) == (one.sample, one.steps, one.method)
    run = Simulation(scene)
    for topic, wrench in commands:
        run.post(topic, wrench, wrench.stamp_ns)
    run.advance(period * 100 + 1)
    assert steps is None or run.steps_computed == steps


@pytest.mark.parametrize(("effects", "refused"), [("", False), (EFFECTS, False), (GRAVITY, True), (BUOYED, False)])
@pytest.mark.parametrize(
    "solver",
    [
        Solver(method="dop853", accuracy=1e-9),
        pytest.param(Solver(method="dverk", accuracy=1e-7), marks=pytest.mark.slow),
        pytest.param(Solver(method="rk4", accuracy=1e-6), marks=pytest.mark.slow),
        pytest.param(Solver(method="rk4", step=1 / 256), marks=pytest.mark.slow),
        Solver(method="auto", accuracy=1e-7),
    ],
    ids=str,
)
def test_outputs_in_plain_python_are_of_array_steps(
    solver: Solver, effects: str, refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the bits and events of one by one, also if the arrays are refused after the strides have been taken."""
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    scene = replace(parse_scene(SCENE.text + effects), solver=solver, duration=1.8, output_rate=500)
    held = [("b", Wrench((0.0, 0.2, 0.0), (0.1, 0.2, -0.1), "world", time_ns)) for time_ns in (0, 1_500_000_001)]
    commands = [*held, ("a", Wrench((1.0, 0.0, 0.0), (0.1, 0.2, -0.1), "body", 400_000_000))]
    taken, arrays = [0], arc.steps_from

    def counted(*arguments: Any) -> Any:
        taken.append(len(arguments[3]))
        return None if refused else arrays(*arguments)

    monkeypatch.setattr(arc, "steps_from", counted)
    singly, together = _Everything(), _Everything()
    one = _singly(scene, commands, singly)
    assert taken == [0]
    many = _run(scene, commands, together)

    assert sum(taken) > 420
    assert repr(together.events) == repr(singly.events)
    assert together.result == singly.result
    assert (many.sample, many.steps, many.method) == (one.sample, one.steps, one.method)


def test_all_methods_that_take_arrays_are_among_those() -> None:
    assert {name for name, method in METHODS.own.items() if method.takes_arrays} == {"dop853", "dverk", "rk4"}


def test_there_an_error_comes_after_all_samples_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RB_DYNAMICS_COMPILE", "never")
    falling = "effects: [{type: central_gravity, gravitational_parameter: 2.0, center_world: [1, 0, 0]}]"
    text = SCENE.text.replace("[0.1, -0.2, 0.05]", "[0, 0, 0]").replace("[0.1, 0, 0.2]", "[0, 0, 0]")
    scene = replace(parse_scene(text + falling), solver=Solver(method="dop853", accuracy=1e-9), output_rate=300)
    kept = []
    for fly in (_singly, _run):
        sink = _Everything()
        with pytest.raises(ConvergenceError) as error:
            fly(scene, (), sink)
        kept.append((sink.events, sink.result, str(error.value)))
    assert kept[0] == kept[1]
    assert len(kept[0][0]) > 150


def test_outputs_within_a_stride_of_taylor_are_of_one_expansion(flown: list[int]) -> None:
    scene = replace(SCENE, solver=Solver(method="taylor", accuracy=1e-9), output_rate=1000)
    commands = [("a", Wrench((1.0, 0.0, 0.0), (0.1, 0.2, -0.1), frame, 400_000_000)) for frame in ("body", "world")]
    one_by_one, blocks = MemorySink(), MemorySink()
    _singly(scene, commands, one_by_one)
    tally = Tally()
    with counted_by(tally):
        _run(scene, commands, blocks)

    assert dense_kernel(TAYLOR) in tally.used
    assert sum(flown) > 2900
    for name in ("position_world", "orientation_xyzw", "angular_velocity_body", "work", "energy_defect"):
        assert getattr(blocks, name).tobytes() == getattr(one_by_one, name).tobytes()


@pytest.mark.parametrize(
    "solver", [Solver(method="dop853", accuracy=1e-9), Solver(method="rk4", step=1 / 256)], ids=str
)
def test_phases_are_what_looks_see(solver: Solver, flown: list[int]) -> None:
    """Across the knots of a rotor; the run ends at the last time."""
    scene = without_outputs(replace(parse_scene(SCENE.text + EFFECTS), solver=solver))
    times = np.array([*range(0, 3_000_000_000, 17_000_000), 3_000_000_000])
    run, looking, rows = Simulation(scene), Simulation(scene), list[Any]()
    for each in (run, looking):
        each.start()
    while len(rows) < len(times):
        rows += run.phases(times[len(rows) :]).tolist()
    assert sum(flown) > 0.9 * len(times)

    for time_ns, row in zip(times.tolist(), rows, strict=True):
        looking.advance(time_ns)
        state, seen = phase_of(tuple(row)).state(scene.body, time_ns), looking.look()
        assert (state.position_world, state.orientation_xyzw) == (seen.position_world, seen.orientation_xyzw)
        assert state.angular_velocity_body == seen.angular_velocity_body
    assert (run.steps, run.methods, run.sample) == (looking.steps, looking.methods, looking.sample)
