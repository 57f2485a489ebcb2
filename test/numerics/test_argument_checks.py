"""Arguments of the Python API: wrong ones raise an error with their name, right ones are accepted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rb_dynamics as rb
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.numerics.rotation import normalize, unit

BODY = rb.RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
SCENE = rb.parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1")
COMMANDS = [("wrench", rb.Wrench())]


def _driven(**changed: Any) -> rb.Samples:
    return rb.driven_motion(
        **{"body": BODY, "state": rb.State(), "times_ns": [10], "method": "rk4", "step": 0.1} | changed
    )


def _ensemble(**changed: Any) -> rb.Ensemble:
    return rb.Ensemble(**{"bodies": BODY, "states": [rb.State()], "method": "rk4", "step": 0.1} | changed)


def _simulated(**changed: Any) -> rb.Run:
    return rb.simulate(replace(SCENE, **changed))


def _from_state(**changed: Any) -> rb.FreeMotion:
    return rb.free_motion(BODY, rb.State(**changed), 1.0)


def _held(**changed: Any) -> object:
    return rb.WrenchFrames().hold(rb.Wrench(**changed))


class Anything:
    """An object of an unsupported type."""

    def __repr__(self) -> str:
        return "Anything()"


NOT_FINITE = [math.nan, math.inf, -math.inf]
NO_NUMBERS = [None, "text", Anything(), {}, 1j, np.complex128(1 + 1j), np.True_, [[1.0]], (1.0, "a", 2.0)]
NO_VECTORS = [*NO_NUMBERS, 1.0, (1.0, 2.0), (1.0, 2.0, 3.0, 4.0, 5.0), (math.nan, 0.0, 0.0), np.ones((3, 3))]
NO_VECTORS += [{3.0, 1.0, 2.0}, {3.0: 0.0, 1.0: 0.0, 2.0: 0.0}]  # without an order; whose keys are not components
NO_OBJECTS = [None, "text", 1.0, [1.0], Anything(), rb.Wrench]
NO_COUNTS = [*NO_NUMBERS, *NOT_FINITE, 0.5]
NO_TIMES = [*NO_COUNTS, 2**63, -(10**400)]
NO_QUATERNIONS = [*NO_VECTORS, (0.0, 0.0, 0.0, 1.4), (0.0, 0.0, 0.0, 0.0), (math.inf, 0.0, 0.0, 1.0)]
NO_LIST_OF_THEM = [None, 1.0, "text", Anything(), [Anything()], [None]]
POSITIVE = [*NO_NUMBERS, *NOT_FINITE, -1.0, 0.0]
NOT_NEGATIVE = [*NO_NUMBERS, *NOT_FINITE, -1.0]
NO_WRENCHES = ["text", True, Anything(), math.nan, [math.inf, 0.0, 0.0], [1.0, 2.0], [[1.0], [2.0, 3.0]]]

# What takes the argument, and what may not be given for it.
WRONG: Mapping[tuple[Callable[..., object], str], list[Any]] = {
    (rb.examine, "body"): NO_OBJECTS,
    (rb.symmetry, "body"): NO_OBJECTS,
    (rb.inertia_ellipsoid, "body"): NO_OBJECTS,
    (lambda body: rb.scalar_inertia(body, (1.0, 0.0, 0.0)), "body"): NO_OBJECTS,
    (lambda axis: rb.scalar_inertia(BODY, axis), "axis"): [*NO_VECTORS, (0.0, 0.0, 0.0)],
    (lambda axis: rb.radius_of_gyration(BODY, axis), "axis"): NO_VECTORS,
    (lambda through: rb.scalar_inertia(BODY, (1.0, 0.0, 0.0), through), "through"): NO_VECTORS[1:],
    (lambda masses: rb.body_of_particles(masses, [(1.0, 0.0, 0.0)]), "masses"): [*NO_LIST_OF_THEM, [-1.0], [1.0, 1.0]],
    (lambda positions: rb.body_of_particles([1.0], positions), "positions"): [*NO_LIST_OF_THEM, [(math.nan,) * 3]],
    (rb.RigidBody.particle, "mass"): POSITIVE,
    (lambda mass: rb.RigidBody.from_diagonal(mass, (1.0, 1.0, 1.0)), "mass"): POSITIVE,
    (lambda moments: rb.RigidBody.from_diagonal(1.0, moments), "moments"): [*NO_VECTORS, (-1.0, 1.0, 1.0)],
    (lambda center_of_mass: rb.RigidBody.from_diagonal(1.0, (1.0,) * 3, center_of_mass), "center_of_mass"): NO_VECTORS,
    (lambda inertia: rb.RigidBody.from_matrix(1.0, inertia), "inertia"): [*NO_NUMBERS, np.eye(2), np.ones((3, 3, 3))],
    (lambda orientation_xyzw: rb.RigidBody.from_principal(1.0, (1.0,) * 3, orientation_xyzw), "orientation_xyzw"): (
        NO_QUATERNIONS
    ),
    (_from_state, "time_ns"): NO_TIMES,
    (_from_state, "position_world"): NO_VECTORS,
    (_from_state, "orientation_xyzw"): NO_QUATERNIONS,
    (_from_state, "linear_velocity_world"): NO_VECTORS,
    (_from_state, "angular_velocity_body"): NO_VECTORS,
    (lambda body: rb.free_motion(body, rb.State(), 1.0), "body"): NO_OBJECTS,
    (lambda state: rb.free_motion(BODY, state, 1.0), "state"): NO_OBJECTS,
    (lambda t: rb.free_motion(BODY, rb.State(), t), "t"): [
        None,
        "text",
        True,
        Anything(),
        *NOT_FINITE,
        [[1.0], [1.0, 2.0]],
    ],
    (_driven, "body"): NO_OBJECTS,
    (_driven, "state"): [*NO_OBJECTS, rb.State(position_world=(math.nan, 0.0, 0.0))],
    (_driven, "times_ns"): [*NO_NUMBERS, 1.5, [1.5], [], [-1], [2, 1]],
    (_driven, "method"): [*NO_OBJECTS, "rk5", "auto"],
    (_driven, "step"): POSITIVE,
    (_driven, "last_only"): [None, 1, "false", math.nan],
    (_driven, "force_body"): NO_WRENCHES,
    (_driven, "torque_world"): NO_WRENCHES,
    (_ensemble, "bodies"): [*NO_LIST_OF_THEM, [BODY, BODY]],
    (_ensemble, "states"): [*NO_LIST_OF_THEM, [], [rb.State(orientation_xyzw=(0.0, 0.0, 0.0, 2.0))], rb.State()],
    (_ensemble, "method"): [*NO_OBJECTS, "rk5"],
    (_ensemble, "step"): POSITIVE,
    (_ensemble, "threads"): [*NO_COUNTS[1:], 0, -1],
    (_ensemble().advance, "seconds"): [*NOT_NEGATIVE, 1e308],
    (_ensemble().advance_to, "time_ns"): [*NO_TIMES, -1],
    (_ensemble().hold, "torque_body"): NO_WRENCHES,
    (lambda times_ns: _ensemble().follow(times_ns), "times_ns"): [*NO_NUMBERS, [1.5], [-1]],
    (rb.LinearDrag, "translation"): [*NO_VECTORS, (-1.0, 0.0, 0.0)],
    (rb.QuadraticDrag, "rotation"): [*NO_VECTORS, (-1.0, 0.0, 0.0)],
    (rb.LinearDrag, "medium_velocity_world"): NO_VECTORS,
    (rb.UniformGravity, "acceleration_world"): NO_VECTORS,
    (rb.CentralGravity, "gravitational_parameter"): POSITIVE,
    (lambda center_world: rb.CentralGravity(1.0, center_world), "center_world"): NO_VECTORS,
    (lambda axis_body: rb.Rotor(axis_body, 1.0, ((0.0, 1.0),)), "axis_body"): [*NO_VECTORS, (0.0, 0.0, 0.0)],
    (lambda axial_inertia: rb.Rotor((0.0, 0.0, 1.0), axial_inertia, ((0.0, 1.0),)), "axial_inertia"): POSITIVE,
    (lambda spin_rate: rb.Rotor((0.0, 0.0, 1.0), 1.0, spin_rate), "spin_rate"): [*NO_NUMBERS, 1.0, [1.0], [(1.0,)]],
    (rb.MagneticField, "model"): [None, "text", 1.0],
    (rb.MagneticField, "field_world"): NO_VECTORS,
    (lambda moment_world: rb.MagneticField("dipole", moment_world=moment_world), "moment_world"): NO_VECTORS,
    (lambda center_world: rb.MagneticField("dipole", center_world=center_world), "center_world"): NO_VECTORS,
    (lambda name: rb.Imu(name=name, rate=1.0), "name"): [None, 1.0],
    (lambda rate: rb.StarTracker(name="a", rate=rate), "rate"): POSITIVE,
    (lambda delay: rb.Magnetometer(name="a", rate=1.0, delay=delay), "delay"): NOT_NEGATIVE,
    (lambda dropout: rb.PoseSensor(name="a", rate=1.0, dropout=dropout), "dropout"): [*NOT_NEGATIVE, 1.0],
    (lambda noise: rb.StarTracker(name="a", rate=1.0, noise=noise), "noise"): NOT_NEGATIVE,
    (lambda direction_world: rb.SunSensor(name="a", rate=1.0, direction_world=direction_world), "direction_world"): [
        *NO_VECTORS,
        (0.0, 0.0, 0.0),
    ],
    (lambda gyro: rb.Imu(name="a", rate=1.0, gyro=gyro), "gyro"): NO_OBJECTS,
    (rb.AxisErrors, "noise_density"): NOT_NEGATIVE,
    (rb.AxisErrors, "bias"): NO_VECTORS,
    (rb.AxisErrors, "range"): [0.0, -1.0, math.nan, None],
    (_simulated, "sensors"): [*NO_LIST_OF_THEM, [rb.Imu(name="pose", rate=1.0)], [rb.Magnetometer(name="a", rate=1.0)]],
    (lambda name: rb.Thruster(name=name, frame="a", force=1.0), "name"): [None, 1.0, "a b"],
    (lambda force: rb.Thruster(name="a", frame="a", force=force), "force"): POSITIVE,
    (lambda minimum_on: rb.Thruster(name="a", frame="a", force=1.0, minimum_on=minimum_on), "minimum_on"): NOT_NEGATIVE,
    (lambda command: rb.Thruster(name="a", frame="a", force=1.0, command=command), "command"): [None, "torque"],
    (lambda axis: rb.Magnetorquer(name="a", axis=axis, max_dipole=1.0), "axis"): [*NO_VECTORS, (0.0, 0.0, 0.0)],
    (lambda max_dipole: rb.Magnetorquer(name="a", axis=(1.0, 0.0, 0.0), max_dipole=max_dipole), "max_dipole"): POSITIVE,
    (rb.Setpoint, "value"): [None, "1", True],
    (_simulated, "actuators"): [
        *NO_LIST_OF_THEM,
        [rb.Magnetorquer(name="a", axis=(1.0, 0.0, 0.0), max_dipole=1.0)],
    ],
    (_simulated, "seed"): [*NO_COUNTS, -1, 2**60],
    (rb.ScheduledWrench, "entries"): [*NO_LIST_OF_THEM, [rb.Wrench()], [(-1.0, rb.Wrench())], [(1.0, 2.0)]],
    (rb.FixedFrame, "position"): NO_VECTORS,
    (rb.FixedFrame, "orientation_xyzw"): NO_QUATERNIONS,
    (rb.WrenchFrames, "world_frame"): [None, 1.0, Anything()],
    (rb.WrenchFrames, "fixed"): ["text", 1.0, [1.0], {"a": None}],
    (rb.WrenchFrames, "center_of_mass"): [value for value in NO_VECTORS if value is not None],
    (rb.WrenchFrames, "turns"): [1, "yes"],
    (rb.WrenchFrames().hold, "wrench"): NO_OBJECTS,
    (_held, "force"): NO_VECTORS,
    (_held, "torque"): NO_VECTORS,
    (_held, "frame_id"): [None, 1.0, Anything(), "nowhere"],
    (rb.simulate, "scene"): [None, 1.0, Anything(), SCENE.body],
    (lambda commands: rb.simulate(SCENE, commands), "commands"): [*NO_LIST_OF_THEM[:-2], rb.Wrench(), [rb.Wrench()]],
    (lambda stamp_ns: rb.simulate(SCENE, [("wrench", rb.Wrench(stamp_ns=stamp_ns))]), "stamp_ns"): NO_COUNTS,
    (lambda sinks: rb.simulate(SCENE, [], sinks), "sinks"): [*NO_LIST_OF_THEM, rb.MemorySink(), [rb.MemorySink]],
    (lambda progress: rb.simulate(SCENE, [], [], progress), "progress"): ["text", 1.0, Anything()],
    (_simulated, "body"): NO_OBJECTS,
    (_simulated, "frames"): NO_OBJECTS,
    (_simulated, "initial"): [*NO_OBJECTS, rb.State(linear_velocity_world=(0.0, 0.0, math.inf))],
    (_simulated, "channels"): [*NO_LIST_OF_THEM, rb.Channel(), [rb.Channel(), rb.Channel()]],
    (rb.Channel, "topic"): [None, 1.0, ""],
    (lambda timeout: rb.Channel(timeout=timeout), "timeout"): NOT_NEGATIVE,
    (lambda max_force: rb.Channel(max_force=max_force), "max_force"): [0.0, -1.0, math.nan, None, "1"],
    (lambda on_excess: rb.Channel(on_excess=on_excess), "on_excess"): [None, "drop"],
    (_simulated, "effects"): [*NO_LIST_OF_THEM, rb.LinearDrag((1.0, 1.0, 1.0))],
    (_simulated, "solver"): NO_OBJECTS,
    (rb.Solver, "method"): [*NO_OBJECTS, "rk5", "RK4"],
    (rb.Solver, "step"): POSITIVE[1:],
    (rb.Solver, "accuracy"): [*POSITIVE[1:], 1.0],
    (_simulated, "duration"): NOT_NEGATIVE,
    (_simulated, "output_rate"): NOT_NEGATIVE,
    (rb.Simulation, "scene"): NO_OBJECTS,
    (lambda topic: rb.Simulation(SCENE).post(topic, rb.Wrench()), "topic"): [None, 1.0, Anything(), "text"],
    (lambda wrench: rb.Simulation(SCENE).post("wrench", wrench), "wrench"): NO_OBJECTS,
    (lambda time_ns: rb.Simulation(SCENE).post("wrench", rb.Wrench(), time_ns), "time_ns"): NO_COUNTS,
    (rb.Simulation(SCENE).advance, "until_ns"): NO_TIMES,
    (rb.explain, "scene"): [None, 1.0, Anything(), SCENE.body],
    (lambda commands: rb.explain(SCENE, commands), "commands"): [*NO_LIST_OF_THEM, [rb.Wrench()]],
    (lambda budget: rb.explain(SCENE, budget=budget), "budget"): POSITIVE,
    (rb.inspect, "log"): [None, 1.0, Anything()],
    (lambda scene: rb.inspect("no.mcap", scene), "scene"): [1.0, Anything(), SCENE.body],
    (lambda bound: rb.inspect("no.mcap", bound=bound), "bound"): POSITIVE,
    (rb.trade, "scene"): [None, 1.0, Anything(), SCENE.body],
    (lambda commands: rb.trade(SCENE, commands), "commands"): [*NO_LIST_OF_THEM, [rb.Wrench()]],
    (lambda target: rb.trade(SCENE, target=target), "target"): POSITIVE[1:],
    (lambda budget: rb.trade(SCENE, budget=budget), "budget"): POSITIVE[1:],
    (lambda time_s: rb.trade(SCENE, time_s=time_s), "time_s"): POSITIVE,
    (lambda volume: rb.Buoyancy(volume, 1.0, (0.0, 0.0, -9.8)), "volume"): POSITIVE,
    (lambda density: rb.Buoyancy(1.0, density, (0.0, 0.0, -9.8)), "density"): POSITIVE,
    (lambda acceleration_world: rb.Buoyancy(1.0, 1.0, acceleration_world), "acceleration_world"): NO_VECTORS,
    (lambda center_body: rb.Buoyancy(1.0, 1.0, (0.0, 0.0, -9.8), center_body), "center_body"): NO_VECTORS,
    (lambda a: rb.compare(a, SCENE), "a"): [None, 1.0, Anything()],
    (lambda bound: rb.compare(SCENE, SCENE, bound=bound), "bound"): [*NO_NUMBERS[1:], *NOT_FINITE, -1.0],
    (lambda scene: rb.identify(scene, ["no.mcap"]), "scene"): [None, 1.0, Anything()],
    (lambda recordings: rb.identify(SCENE, recordings), "recordings"): [None, 1.0, [], [1.0], Anything()],
    (lambda fit: rb.identify(SCENE, ["no.mcap"], fit), "fit"): [1.0, "inertia", ["text"], [1.0]],
    (lambda loss: rb.identify(SCENE, ["no.mcap"], loss=loss), "loss"): [None, 1.0, "text"],
    (lambda starts: rb.identify(SCENE, ["no.mcap"], starts=starts), "starts"): [*NO_COUNTS, 0],
    (rb.covariance, "log"): [None, 1.0, Anything()],
    (lambda uncertain: rb.covariance("no.mcap", uncertain), "uncertain"): [1.0, [0.1], Anything()],
    (lambda sigmas: rb.covariance("no.mcap", sigmas=sigmas), "sigmas"): [1.0, "text", ["mass"], Anything()],
    (rb.read_scene, "path"): [None, 1.0, Anything()],
    (rb.parse_scene, "text"): [None, 1.0, Anything()],
    (lambda overrides: rb.parse_scene("body: {mass: 1}", overrides=overrides), "overrides"): [None, 1.0, ["a"]],
}
CASES = [
    (take, name, value)
    for (take, name), values in WRONG.items()
    for value in values
    if name != "duration" or value is not None
]


@pytest.mark.parametrize(("take", "name", "value"), CASES, ids=[f"{name}-{k}" for k, (_, name, _) in enumerate(CASES)])
def test_what_is_wrong_is_named(take: Callable[..., object], name: str, value: object) -> None:
    with pytest.raises((TypeError, ValueError, rb.RigidBodyError)) as error:
        take(**{name: value})
    # A message with an expectation is one of ours, and no slip of Python's within.
    assert name in str(error.value)
    assert "expected" in str(error.value)


def test_every_public_function_and_effect_is_tried() -> None:
    table = Path(__file__).read_text(encoding="utf-8").partition("WRONG:")[2].partition("CASES")[0]
    functions = {name for name in rb.__all__ if callable(found := getattr(rb, name)) and not isinstance(found, type)}
    effects = {effect.__name__ for effect in EFFECTS.own.values()}
    # driven_motion is tried as _driven.
    missing = sorted({name for name in functions | effects if f"rb.{name}" not in table} - {"driven_motion"})
    assert not missing, (
        f"missing in WRONG: {', '.join(missing)}; list it in rb_dynamics/__init__.pyi and add a row for each argument"
    )


def test_arrays_of_numpy_are_taken_for_tuples() -> None:
    state = rb.State(0, *(np.array(v) for v in ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), (4, 5, 6), (0.1, 0.2, 0.3))))
    plain = rb.State(0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), (4.0, 5.0, 6.0), (0.1, 0.2, 0.3))
    assert replace(SCENE, initial=state).initial == plain
    assert rb.WrenchFrames().hold(rb.Wrench(np.ones(3), np.zeros(3))).force_body == (1.0, 1.0, 1.0)
    assert rb.LinearDrag(np.ones(3)) == rb.LinearDrag((1.0, 1.0, 1.0))


def test_the_path_of_a_scene_is_taken_for_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.text)
    assert rb.simulate(path).sample == rb.simulate(str(path)).sample == rb.simulate(SCENE).sample
    assert rb.explain(str(path)).solver == rb.explain(SCENE).solver


@given(st.tuples(*(st.floats(-1.0, 1.0) for _ in range(4))))
def test_an_attitude_of_norm_1_is_kept_to_the_bit(q: tuple[float, float, float, float]) -> None:
    if math.hypot(*q) < 1e-3:
        return
    made = normalize(q)
    assert unit(made) == made
    off = tuple(1.0005 * c for c in made)
    assert unit(off) == normalize(off)
    assert unit(tuple(1.002 * c for c in made)) is None
