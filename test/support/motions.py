"""Reference motions: a forced body to 30 digits, free bodies to 34, and the error of a run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from mpmath import mp, mpf

from rb_dynamics import motion
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.wrench import HeldWrench, Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.motion.arc import Arc
from rb_dynamics.motion.method import Method
from rb_dynamics.motion.phase_state import PhaseState, in_principal_axes, inertia_of
from rb_dynamics.motion.step_control import FixedStep
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import norm, subtract
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import Event, RunInfo
from rb_dynamics.scene.model import Scene, Solver

DATA = Path(__file__).parents[1] / "verification" / "data"

EPS = 2.0**-52

METHODS = motion.METHODS.own
"""Those of this package: what is installed beside it is not ours to hold to anything."""

STEPPED = {name: method for name, method in METHODS.items() if method.order is not None}
"""The methods that step; the others are closed forms, for the motions that have one."""


class Recorder:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.run: RunInfo | None = None
        self.events: list[Event] = []
        self.result: Mapping[str, str] | None = None

    def open(self, run: RunInfo) -> None:
        self.run = run

    def write(self, event: Event) -> None:
        self.events.append(event)

    def close(self, result: Mapping[str, str]) -> None:
        self.result = result

    @property
    def samples(self) -> list[Sample]:
        return [event for event in self.events if isinstance(event, Sample)]


@dataclass(frozen=True)
class Case:
    """A motion under one held wrench with its states to many digits."""

    body: RigidBody
    initial: State
    held: HeldWrench
    states: Mapping[float, Mapping[str, Any]] = field(repr=False)

    @property
    def commands(self) -> list[tuple[str, Wrench]]:
        """The wrench as commands on the channels `body` and `world`, from 0 on."""
        return [
            ("body", Wrench(self.held.force_body, self.held.torque_body, "body")),
            ("world", Wrench(self.held.force_world, self.held.torque_world, "world")),
        ]

    def scene(self, solver: Solver, duration: float, output_rate: float = 100.0) -> Scene:
        return scene(
            self.body, self.initial, solver, duration, output_rate, channels=(Channel("body"), Channel("world"))
        )


def scene(
    body: RigidBody,
    initial: State | None = None,
    solver: Solver | None = None,
    duration: float | None = 1.0,
    output_rate: float = 100.0,
    channels: Iterable[Channel] = (Channel(),),
) -> Scene:
    frames = WrenchFrames(center_of_mass=body.center_of_mass)
    return Scene(body, frames, initial or State(), tuple(channels), solver or Solver(), duration, output_rate)


@cache
def forced() -> Case:
    """A triaxial, off-diagonal body whose centre of mass is not its origin, under all four kinds of wrench."""
    document = json.loads((DATA / "forced_motion.json").read_text(encoding="utf-8"))
    case = document["case"]
    initial = State(0, *(tuple(case[name]) for name in State.__slots__[1:]))
    held = HeldWrench(*(tuple(case[name]) for name in HeldWrench._fields))
    body = RigidBody.from_matrix(case["mass"], case["inertia"], case["center_of_mass"])
    return Case(body, initial, held, {state["time"]: state for state in document["states"]})


@cache
def free(name: str) -> Case:
    """A torque-free body: `dzhanibekov` or `boxes_rotation`."""
    case = json.loads((DATA / "free_motion.json").read_text(encoding="utf-8"))["cases"][name]
    body = RigidBody.from_matrix(case["mass"], case["inertia"])
    initial = State(
        linear_velocity_world=tuple(case["linear_velocity_world"]),
        angular_velocity_body=tuple(case["angular_velocity_body"]),
    )
    states = {}
    for state in case["states"]:
        w, x, y, z = state["q"]
        states[state["t"]] = {
            "position_world": state["x"],
            "orientation_xyzw": [x, y, z, w],
            "linear_velocity_world": state["v"],
            "angular_velocity_body": state["w"],
        }
    return Case(body, initial, HeldWrench(), states)


def move(case: Case, method: Method, step: float, duration: float) -> PhaseState:
    """Return where `method` brings the body of `case` with a fixed step."""
    held = in_principal_axes(case.body, case.held)
    arc = Arc(method, inertia_of(case.body), held, FixedStep(step), 0, PhaseState.of(case.body, case.initial))
    return arc.at(round(duration * NANOSECONDS))


def errors(case: Case, time: float, phase: PhaseState) -> dict[str, float]:
    """Return the error of each quantity of `phase` at `time`, with the reference subtracted at 50 digits."""
    reference, state = case.states[time], phase.state(case.body, 0)
    found = {
        name: vector_error(getattr(state, name), reference[name])
        for name in ("position_world", "linear_velocity_world", "angular_velocity_body")
    }
    found["attitude"] = attitude_error(state.orientation_xyzw, reference["orientation_xyzw"])
    if "work" in reference:
        found["work"] = vector_error((phase.work,), (reference["work"],))
        for name in ("impulse_world", "torque_impulse_world"):
            found[name] = vector_error(getattr(phase, name), reference[name])
    return found


def vector_error(found: Iterable[float], expected: Iterable[str]) -> float:
    """Return |found - expected|, the difference taken at 50 digits."""
    with mp.workdps(50):
        return float(mp.sqrt(mp.fsum((mpf(a) - mpf(b)) ** 2 for a, b in zip(found, expected, strict=True))))


def attitude_error(found: Iterable[float], expected: Iterable[str]) -> float:
    """Return the angle (rad) between two attitudes, to the last digit of `found`."""
    with mp.workdps(50):
        p, q = [mpf(c) for c in found], [mpf(c) for c in expected]
        scale = mp.sqrt(mp.fdot(p, p) * mp.fdot(q, q))
        sign = mp.sign(mp.fdot(p, q))
        p, q = [c * sign / mp.sqrt(mp.fdot(p, p)) for c in p], [c / mp.sqrt(mp.fdot(q, q)) for c in q]
        chord = mp.sqrt(mp.fsum((a - b) ** 2 for a, b in zip(p, q, strict=True)))
        assert scale > 0
        return float(4 * mp.asin(chord / 2))


def distance(a: Sample | State, b: Sample | State) -> dict[str, float]:
    """Return how far two states are apart."""
    return {
        "attitude": angle_between(a.orientation_xyzw, b.orientation_xyzw),
        "rate": norm(subtract(a.angular_velocity_body, b.angular_velocity_body)),
        "position": norm(subtract(a.position_world, b.position_world)),
        "velocity": norm(subtract(a.linear_velocity_world, b.linear_velocity_world)),
    }


def slope(steps: list[float], values: list[float]) -> float:
    """Return the least-squares slope of log(values) over log(steps)."""
    xs, ys = [math.log(h) for h in steps], [math.log(v) for v in values]
    mean_x, mean_y = math.fsum(xs) / len(xs), math.fsum(ys) / len(ys)
    return math.fsum((x - mean_x) * (y - mean_y) for x, y in zip(xs, ys, strict=True)) / math.fsum(
        (x - mean_x) ** 2 for x in xs
    )
