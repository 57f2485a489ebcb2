"""Invalid results of a user's effect are refused: loads and distances of sight."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rb_dynamics import Effect, Run, Solver, parse_scene, simulate
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.effect import Sight, Wrenching
from rb_dynamics.loads.load import LoadDependence
from rb_dynamics.numerics.vector import ZERO

SCENE = parse_scene("body: {mass: 1, inertia: {diagonal: [1, 1.5, 2]}}\nduration: 0.5\noutput_rate: 0")
PUSH = ((1.0, 0.0, 0.0), ZERO)


class Own(Effect):
    """An effect that returns what it is told."""

    kind, takes = "own", LoadDependence.FIELD

    def __init__(self, load: Any, sight: Any = math.inf) -> None:
        self.load, self.ahead = load, sight

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        return lambda point: self.load

    def sight(self, body: RigidBody) -> Sight:
        return lambda point: self.ahead


def flown(load: Any, sight: Any = math.inf, **solver: Any) -> Run:
    return simulate(replace(SCENE, effects=(Own(load, sight),), solver=Solver("rk4", **solver)))


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
    with pytest.raises(TypeError, match=r"^own: its load is .*, expected a force \(N, world axes\) and a torque"):
        flown(load, **solver)


@pytest.mark.parametrize("sight", [0.0, -1.0, math.nan])
def test_a_sight_that_is_no_time_ahead_is_named(sight: float) -> None:
    """The run went on in steps of 1 ns, or took no notice."""
    with pytest.raises(
        ConvergenceError, match=r"own: its sight fails .*, expected a time greater than 0; .* at simula"
    ):
        flown(PUSH, sight, accuracy=1e-6)


@pytest.mark.parametrize("sight", [None, "1", np.ones(2)])
def test_a_sight_that_is_no_number_is_named(sight: Any) -> None:
    with pytest.raises(TypeError, match=r"own: its sight is .*, expected a time"):
        flown(PUSH, sight, accuracy=1e-6)
