"""Invalid parts of a user's effect are refused by name."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rb_dynamics import Effect, Run, Solver, parse_scene, simulate
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.effect import Sight, Stored, Wrenching
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.vector import ZERO

SCENE = parse_scene("body: {mass: 1, inertia: {diagonal: [1, 1.5, 2]}}\nduration: 0.5\noutput_rate: 0")
PUSH = ((1.0, 0.0, 0.0), ZERO)


class Own(Effect):
    """An effect that returns given values."""

    kind, takes = "own", LoadDependence.FIELD

    def __init__(self, load: Any, sight: Any = math.inf) -> None:
        self.load, self.ahead = load, sight

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        return self.load if callable(self.load) else lambda point: self.load

    def sight(self, body: RigidBody) -> Sight:
        return lambda point: self.ahead


def flown(load: Any, sight: Any = math.inf, **solver: Any) -> Run:
    return fly(Own(load, sight), **solver)


def fly(effect: Effect, **solver: Any) -> Run:
    return simulate(replace(SCENE, effects=(effect,), solver=Solver("rk4", **solver)))


@pytest.mark.parametrize("load", [list(map(list, PUSH)), np.array(PUSH), tuple(map(np.array, PUSH)), ((1, 0, 0), ZERO)])
def test_a_force_and_a_torque_are_any_sequences_of_doubles(load: Any) -> None:
    assert flown(load, step=0.1).sample.position_world == flown(PUSH, step=0.1).sample.position_world


@pytest.mark.parametrize(
    "load",
    [
        None,
        1.0,
        (1.0, 0.0, 0.0),
        (1.0, 0.0),
        ((1.0, 0.0), ZERO),
        ((1.0, 0.0, 0.0, 5.0), ZERO),
        ("100", ZERO),
        ((1j, 0.0, 0.0), ZERO),
        ((None, 0.0, 0.0), ZERO),
        # In single precision the sums were too: x was off by 6e-8 after 10 s, without a word.
        ((np.float32(0.1), 0.0, 0.0), ZERO),
        (np.zeros(3, dtype=np.float32), ZERO),
    ],
)
@pytest.mark.parametrize("solver", [{"step": 0.1}, {"accuracy": 1e-6}])
def test_what_is_no_load_is_named(load: Any, solver: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match=r"^own: its load is .*, expected a force \(N, world axes\) and a torque"):
        flown(load, **solver)


@pytest.mark.parametrize("sight", [0.0, -1.0, math.nan])
def test_a_sight_that_is_no_time_ahead_is_named(sight: float) -> None:
    """Before it was checked, the run went on in steps of 1 ns or ignored it."""
    with pytest.raises(SceneError, match=r"own: its sight is .*, expected a time \(s\) greater than 0 at simula"):
        flown(PUSH, sight, accuracy=1e-6)


@pytest.mark.parametrize("sight", [None, "1", np.ones(2)])
def test_a_sight_that_is_no_number_is_named(sight: Any) -> None:
    with pytest.raises(SceneError, match=r"own: its sight is .*, expected a time"):
        flown(PUSH, sight, accuracy=1e-6)


NAN = float("nan")
WRONG: list[tuple[str, Any, str]] = [
    ("takes", "FIELD", "takes is 'FIELD', expected a LoadDependence"),
    ("kind", 3, "kind is 3, expected the name of the effect"),
    ("knots", lambda _: "abc", r"knots is 'abc', expected times"),
    ("knots", lambda _: 1.0, r"knots is 1.0, expected times"),
    ("knots", lambda _: None, r"knots is None, expected times"),
    ("knots", lambda _: (1.0, NAN), r"knots is \[1.0, nan\], expected finite times \(s\), found nan among them"),
    ("schedule", lambda *_: "x", "schedule is 'x', expected pairs of a time"),
    ("schedule", lambda *_: 1, "schedule is 1, expected pairs of a time"),
    ("schedule", lambda *_: ((NAN, Wrench()),), r"schedule is .*; found \(nan, Wrench.* among them"),
    ("schedule", lambda *_: ((0.0, "w"),), r"schedule is .*; found \(0.0, 'w'\) among them"),
    ("wrenching", lambda *_: 3.0, "load is 3.0, expected a function of the point"),
    ("sight", lambda *_: 3.0, "sight is 3.0, expected a function of the point"),
    *(
        (name, value, message)
        for name, unit in (("potential", "J"), ("slowing", "1/s"))
        for value, message in (
            (lambda *_: "x", f"{name} is 'x', expected a function of the point"),
            (lambda *_: lambda _: NAN, rf"{name} is nan, expected a finite float.* \({unit}\) at simulation time "),
            (lambda *_: lambda _: "a", f"{name} is 'a', expected a finite float"),
        )
    ),
    ("slowing", lambda *_: lambda _: -1.0, "slowing is -1.0, expected a finite float of 0 or more"),
    ("storing", lambda *_: 1.0, "storing is 1.0, expected a function of the point"),
    ("storing", lambda *_: lambda _: (1.0, 2.0), r"storing is \(1.0, 2.0\), expected Stored"),
    ("storing", lambda *_: lambda _: Stored((NAN, 0.0, 0.0), 0.0), "storing is .*, expected Stored.* finite floats"),
]


@pytest.mark.parametrize(("name", "value", "message"), WRONG)
def test_a_part_of_a_wrong_kind_is_named(name: str, value: Any, message: str) -> None:
    effect = type("Wrong", (Own,), {name: value})(PUSH)
    kind = "3" if name == "kind" else "own"
    with pytest.raises(SceneError, match=f"^{kind}: its {message}.*; correct the effect$"):
        fly(effect, accuracy=1e-6)


@pytest.mark.parametrize("name", ["gravity", "magnetic_field"])
@pytest.mark.parametrize(
    ("field", "message"),
    [
        (3.0, "3.0, expected a function of the place"),
        (lambda _: "abc", "'abc', expected three finite floats"),
        (lambda _: (NAN, 0.0, 0.0), "expected three finite floats"),
    ],
)
def test_a_field_of_a_wrong_kind_is_named(name: str, field: Any, message: str) -> None:
    effects = CombinedEffects(RigidBody.particle(1.0), (type("Wrong", (Own,), {name: lambda _: field})(None),))
    with pytest.raises(SceneError, match=f"^own: its {name} is .*{message}"):
        getattr(effects, name)()(ZERO)


def test_a_load_that_jumps_where_it_has_no_knot_is_told_so() -> None:
    """A look at the size of the wrench, as was advised, leads nowhere."""
    jumps = Own(lambda point: (ZERO, (0.0, 0.5 if point.time > 0.028 else 0.0, 0.0)))
    spins = replace(SCENE.initial, angular_velocity_body=(0.1, 1.0, 0.1))
    with pytest.raises(ConvergenceError, match=r"discontinuous.*, and its effect should name the time in knots"):
        simulate(replace(SCENE, initial=spins, effects=(jumps,), solver=Solver("dop853", accuracy=1e-12)))


class Knotted(Own):
    """A force that begins at a knot, which no whole nanosecond is; `by` says what decides."""

    def __init__(self, by: str) -> None:
        super().__init__(PUSH)
        self.by = by

    def knots(self) -> tuple[float, ...]:
        return (0.1 * 3,)

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        if self.by == "start":
            return lambda point: PUSH if start >= 0.1 * 3 else (ZERO, ZERO)
        if self.by == "time":
            return lambda point: PUSH if point.time >= 0.1 * 3 else (ZERO, ZERO)
        return lambda point: ((max(0.0, point.time - 0.1 * 3), 0.0, 0.0), ZERO)


def test_a_load_chosen_by_start_acts_from_its_knot_on() -> None:
    """Also where the knot is a little after its nanosecond: it acted never."""
    for solver in ({"step": 0.1}, {"accuracy": 1e-9}):
        assert fly(Knotted("start"), **solver).sample.linear_momentum_world[0] == pytest.approx(0.2, rel=1e-12)
    assert fly(Knotted("ramp"), step=0.1).sample.linear_momentum_world[0] == pytest.approx(0.02, rel=1e-9)


def test_a_load_that_jumps_with_the_time_at_its_knot_is_refused() -> None:
    with pytest.raises(
        SceneError, match=r"own: its load jumps .* at its knot 0.3.* let wrenching\(body, start\) choose"
    ):
        fly(Knotted("time"), step=0.1)


@pytest.mark.parametrize("solver", [{"step": 0.1}, {"accuracy": 1e-6}])
def test_a_load_that_is_no_number_or_fails_is_named_by_every_solver(solver: Any) -> None:
    for load in (((NAN, 0.0, 0.0), ZERO), (ZERO, (0.0, NAN, 0.0)), (ZERO, (math.inf, 0.0, 0.0))):
        with pytest.raises(ConvergenceError, match=r"own: its load is .*(nan|inf).* at simulation time"):
            flown(load, **solver)
    with pytest.raises(ConvergenceError, match="own: its load fails with ZeroDivisionError"):
        flown(lambda point: ((1.0 / point.time, 0.0, 0.0), ZERO), **solver)


def test_the_end_of_a_loads_domain_is_no_discontinuity() -> None:
    with pytest.raises(ConvergenceError, match=r"own: its load fails with ValueError: .*at simulation time 0\.25"):
        flown(lambda point: ((math.sqrt(0.25 - point.time), 0.0, 0.0), ZERO), accuracy=1e-9)
