"""The problems that all peers solve, and the interface of a peer.

SI units, quaternions (x, y, z, w) from body to world axes; the body origin is the centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import rb_dynamics as rb

CONFIG = Path(__file__).resolve().parents[2] / "config"
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Orbit:
    """What acts on a body in orbit about the origin.

    Attributes:
        position_world: the initial one, m.
        rotor: angular momentum of a rotor at a constant rate relative to the body, kg m^2/s, body axes.
        drag: linear, of velocity (N s/m) and of angular velocity (N m s/rad).
    """

    gravitational_parameter: float
    position_world: Vector
    rotor: Vector = (0.0, 0.0, 0.0)
    drag: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Problem:
    """A rigid body, its initial state, its wrenches, and the attitude error to reach at the end.

    Attributes:
        inertia: 3 x 3, about the centre of mass, body axes.
        angular_velocities: (n, 3), body axes; one row for each body, alike but for this.
        force_body, torque_body, force_world: (k, 3), held one after the other for `duration` / k s each.
        orbit: what acts in orbit, gravity gradient included; only peers with `ORBITS` are asked for it.
        wanted: error of the attitude at the end (of the worst body) that the comparison is made at, rad.
        bars: the ratio wanted of a peer's time to ours, by its name.
    """

    name: str
    title: str
    text: str
    mass: float
    inertia: np.ndarray
    angular_velocities: np.ndarray
    duration: float
    wanted: float
    orientation_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    linear_velocity_world: Vector = (0.0, 0.0, 0.0)
    gravity: Vector = (0.0, 0.0, 0.0)
    orbit: Orbit | None = None
    force_body: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    torque_body: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    force_world: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    bars: dict[str, float] = field(default_factory=dict)

    @property
    def bodies(self) -> int:
        return len(self.angular_velocities)

    @property
    def holds(self) -> int:
        """Number of wrenches held one after the other."""
        return len(self.force_body)

    @property
    def hold(self) -> float:
        """Duration of each, s."""
        return self.duration / self.holds

    @property
    def is_free(self) -> bool:
        """Whether the motion is torque-free, for which there are closed forms."""
        return not self.torque_body.any() and self.orbit is None

    @property
    def position_world(self) -> Vector:
        """The initial position of each body, m."""
        return self.orbit.position_world if self.orbit else (0.0, 0.0, 0.0)

    @property
    def rate(self) -> float:
        """The largest |w| at the start, rad/s."""
        return float(np.linalg.norm(self.angular_velocities, axis=1).max())


@dataclass(frozen=True)
class Answer:
    """Attitude (n, 4), angular velocity in body axes (n, 3) and position of the centre of mass (n, 3) at the end."""

    orientation_xyzw: np.ndarray
    angular_velocity_body: np.ndarray
    position_world: np.ndarray

    @classmethod
    def of(cls, orientation_xyzw: Any, angular_velocity_body: Any, position_world: Any) -> Answer:
        """Return an answer of arrays of any shape."""
        q, w, x = orientation_xyzw, angular_velocity_body, position_world
        return cls(np.reshape(q, (-1, 4)).astype(float), np.reshape(w, (-1, 3)), np.reshape(x, (-1, 3)))


def attitude_error(found: Answer, expected: Answer) -> float:
    """Return the largest angle (rad) between two sets of attitudes; infinite if one is not a number."""
    p = found.orientation_xyzw / np.linalg.norm(found.orientation_xyzw, axis=1)[:, None]
    (x, y, z, w), (a, b, c, d) = p.T, expected.orientation_xyzw.T
    vector = np.stack((d * x - w * a - b * z + c * y, d * y - w * b - c * x + a * z, d * z - w * c - a * y + b * x))
    angle = 2.0 * np.arctan2(np.linalg.norm(vector, axis=0), np.abs(w * d + x * a + y * b + z * c))
    return float(angle.max()) if np.isfinite(angle).all() else np.inf


Run = Callable[[], Callable[[], Answer]]


@dataclass(frozen=True)
class Way:
    """One way in which a peer can solve a problem: a method with the settings to try, from coarse to fine.

    Attributes:
        kind: "steps" (in each hold, or in all of a problem with one hold), "tolerance", or "" for a method without.
        first: the coarsest setting.
        prepare: does for a setting everything that is done once, and returns the run: it starts at the initial state,
            ends at the end, is what is timed, and returns what reads its answer.
    """

    name: str
    kind: str
    first: float
    prepare: Callable[[float], Run]


class Peer(Protocol):
    """A module `peers/<name>.py`; `ORBITS = True` where it can solve problems in orbit."""

    NAME: str
    PACKAGES: tuple[str, ...]

    def ways(self, problem: Problem) -> list[Way]:
        """Return the ways in which this peer can solve `problem`; empty if it cannot."""


def steps(problem: Problem, radians: float) -> int:
    """Return the number of steps in a hold for about `radians` of rotation each."""
    return max(1, round(problem.rate * problem.hold / radians))


def threads_named(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def problem(name: str) -> Problem:
    return PROBLEMS[name]()


_TRIAXIAL = np.array([[1.9, -0.21, 0.17], [-0.21, 2.6, 0.29], [0.17, 0.29, 1.4]])


def coast(name: str = "coast", rate: float = 0.4) -> Problem:
    return Problem(
        name,
        f"One hour of coasting at {rate:g} rad/s",
        f"A triaxial body tumbles without torque for an hour ({3600.0 * rate / (2.0 * np.pi):.0f} turns); only the "
        "final state is wanted. The time of the closed form does not depend on the number of turns, that of the "
        "others is proportional to it. The ratio therefore depends on the rate, so two rates are shown.",
        mass=2.6,
        inertia=np.diag([1.4, 2.0, 2.6]),
        angular_velocities=np.array([[0.4 * rate, -0.7 * rate, 0.6 * rate]]),
        duration=3600.0,
        wanted=1e-12,
        linear_velocity_world=(0.01, -0.02, 0.015),
        bars={"Basilisk RKF78": 1000.0, "heyoka": 20.0},
    )


def _shipped(file: str, **more: Any) -> Problem:
    scene = rb.read_scene(CONFIG / file)
    gravity = [tuple(e.acceleration_world) for e in scene.effects if isinstance(e, rb.UniformGravity)]
    return Problem(
        mass=scene.body.mass,
        inertia=np.array(scene.body.inertia),
        angular_velocities=np.array([scene.initial.angular_velocity_body]),
        duration=float(scene.duration or 0.0),
        linear_velocity_world=scene.initial.linear_velocity_world,
        orientation_xyzw=scene.initial.orientation_xyzw,
        gravity=gravity[0] if gravity else (0.0, 0.0, 0.0),
        wanted=1e-9,
        **more,
    )


def tumble() -> Problem:
    return _shipped(
        "dzhanibekov.yaml",
        name="tumble",
        title="A Dzhanibekov tumble",
        text="`config/dzhanibekov.yaml`: a spin about the middle axis flips again and again, for 100 s.",
    )


def boxes() -> Problem:
    return _shipped(
        "boxes.yaml",
        name="boxes",
        title="The boxes benchmark",
        text="`config/boxes.yaml`, the public benchmark of physics engines (scpeters/benchmark, case with gravity): a "
        "box that tumbles about its middle axis and falls, for 10 s.",
    )


def driven(name: str = "driven", spin: float = 1.0) -> Problem:
    count = 10_000
    k = np.arange(count)[:, None]

    def sines(amplitude: Vector, frequency: Vector, phase: Vector) -> np.ndarray:
        return np.round(1024.0 * np.array(amplitude) * np.sin(np.array(frequency) * k + np.array(phase))) / 1024.0

    return Problem(
        name,
        f"Ten thousand held wrenches at {spin:g} rad/s",
        "Force and torque in body axes and a force in world axes, all three changing every 0.01 s for 100 s, on a "
        f"triaxial body with off-diagonal inertia that spins at about {spin:g} rad/s. A slower spin gains less from a "
        "high order: at 1 rad/s one step of order 4 is enough between two commands, at 5 rad/s it is not.",
        mass=2.6,
        inertia=_TRIAXIAL,
        angular_velocities=np.array([[0.4 * spin, -0.7 * spin, 0.6 * spin]]),
        duration=100.0,
        wanted=1e-9,
        linear_velocity_world=(-0.2, 0.15, 0.1),
        force_body=sines((0.9, 0.7, 0.8), (0.23, 0.31, 0.17), (0.1, 1.3, 2.2)),
        torque_body=sines((0.5, 0.4, 0.6), (0.29, 0.19, 0.37), (0.7, 2.9, 1.9)),
        force_world=sines((0.6, 0.9, 0.7), (0.13, 0.27, 0.33), (2.5, 0.4, 1.1)),
        bars={"MuJoCo RK4": 100.0, "Basilisk RKF78": 100.0, "heyoka": 6.0, "C RK4": 1.0},
    )


def orbit(name: str = "orbit", title: str = "One orbit with gravity gradient, drag and rotor", **more: Any) -> Problem:
    mu, radius = 3.986004418e14, 6_878_137.0
    return Problem(
        name,
        title,
        more.pop(
            "text",
            "A satellite of 300 kg tumbles at 0.03 rad/s through one orbit (5677 s), with gravity gradient, drag and "
            "a rotor. Only the final state is wanted.",
        ),
        mass=300.0,
        inertia=np.array([[90.0, 3.0, -2.0], [3.0, 120.0, 4.0], [-2.0, 4.0, 60.0]]),
        angular_velocities=np.array([[0.01, -0.02, 0.015]]),
        duration=round(2.0 * np.pi * np.sqrt(radius**3 / mu), 3),
        wanted=1e-9,
        linear_velocity_world=(0.0, 5383.0, 5383.0),
        orbit=Orbit(mu, (radius, 0.0, 0.0), **more),
    )


def orbit_alone() -> Problem:
    return orbit(
        "orbit-gradient",
        "One orbit with gravity gradient",
        text="The same without drag and rotor, which Basilisk does not have in this form.",
    )


def ensemble(bodies: int = 4096) -> Problem:
    return Problem(
        "ensemble",
        f"An ensemble of {bodies}",
        f"{bodies} bodies that differ only in their spin fire the same thruster for 2 s, as in a Monte Carlo study.",
        mass=2.6,
        inertia=_TRIAXIAL,
        angular_velocities=np.random.default_rng(1).normal(scale=0.6, size=(bodies, 3)),
        duration=2.0,
        wanted=1e-6,
        force_body=np.array([[0.9, -0.4, 0.6]]),
        torque_body=np.array([[0.3, -0.2, 0.25]]),
    )


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "coast": coast,
    "coast-slow": lambda: coast("coast-slow", 0.1),
    "tumble": tumble,
    "boxes": boxes,
    "driven": driven,
    "driven-fast": lambda: driven("driven-fast", 5.0),
    "orbit": lambda: orbit(rotor=(1.2, -0.7, 0.5), drag=(1e-7, 1e-3)),
    "orbit-gradient": orbit_alone,
    "ensemble": ensemble,
}
