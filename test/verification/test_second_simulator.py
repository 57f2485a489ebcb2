"""Independent simulators give the same motion: DOP853 on textbook equations, point masses, Basilisk.

Each is self-contained and shares nothing with the package: no rotation, no principal axes, no wrench rule.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from motions import Recorder, scene
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.loads.wrench import FixedFrame, Wrench, WrenchFrames
from rb_dynamics.loads.wrench_channels import Channel
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.model import Scene, Solver

Array = NDArray[np.float64]

SECOND = 1_000_000_000


def turn_matrix(q: Array) -> Array:
    """Return the matrix of a quaternion (w, x, y, z) of any length."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def angle(sample: Sample, q: Array) -> float:
    x, y, z, w = sample.orientation_xyzw
    mine, other = np.array([w, x, y, z]), q / np.linalg.norm(q)
    return 2.0 * min(float(np.linalg.norm(mine - other)), float(np.linalg.norm(mine + other)))


def apart(sample: Sample, q: Array, omega: Array, position: Array, velocity: Array) -> dict[str, float]:
    """Return the differences of a sample from attitude (w, x, y, z), body rate, position and velocity."""
    return {
        "attitude": angle(sample, q),
        "rate": math.dist(sample.angular_velocity_body, omega),
        "position": math.dist(sample.position_world, position),
        "velocity": math.dist(sample.linear_velocity_world, velocity),
    }


def largest(found: list[dict[str, float]]) -> dict[str, float]:
    return {name: max(each[name] for each in found) for name in found[0]}


@dataclass(frozen=True)
class Push:
    """A wrench from `start` (s) on until the next one of its channel."""

    start: float
    channel: str
    frame: str
    force: tuple[float, float, float]
    torque: tuple[float, float, float]


class TestTextbookEquations:
    """Motion about the body ORIGIN, not the center of mass: the six equations coupled by m c, with the inertia there.

    Unknowns: quaternion (w, x, y, z), angular velocity, position and velocity of the origin. In body axes

        m (a_o + w' x c + w x (w x c)) = F,   I_o w' + w x I_o w + m c x a_o = N_o.
    """

    MASS = 4.2
    CENTER = np.array([0.31, -0.12, 0.2])
    INERTIA = np.array([[1.9, 0.11, -0.23], [0.11, 1.4, 0.27], [-0.23, 0.27, 2.4]])
    FRAME_PLACE = np.array([-0.4, 0.5, 0.3])
    FRAME_AXES = np.array([0.8, 0.0, 0.36, -0.48])  # (w, x, y, z)

    INITIAL = State(
        position_world=(1.0, -2.0, 3.0),
        orientation_xyzw=(0.1, -0.5, 0.5, 0.7),
        linear_velocity_world=(0.2, 0.1, -0.3),
        angular_velocity_body=(0.4, -0.9, 0.6),
    )
    PUSHES = (
        Push(0.0, "a", "body", (0.9, -0.4, 0.6), (0.3, -0.2, 0.25)),
        Push(0.25, "b", "world", (-0.5, 0.8, 0.3), (0.2, 0.35, -0.3)),
        Push(0.618033989, "c", "tool", (0.7, 0.2, -0.8), (-0.1, 0.15, 0.2)),
        Push(1.1, "a", "", (-0.6, 0.5, 0.0), (-0.2, 0.1, -0.3)),
        Push(1.5, "b", "tool", (0.0, -0.6, 0.4), (0.0, 0.0, 0.0)),
        Push(1.5, "c", "world", (0.0, 0.0, 0.0), (-0.3, 0.0, 0.1)),
        Push(2.2, "a", "world", (0.1, 0.2, 0.3), (0.0, 0.1, 0.0)),
    )
    END = 3.0

    def inertia_at_origin(self) -> Array:
        c = self.CENTER
        return self.INERTIA + self.MASS * (c @ c * np.eye(3) - np.outer(c, c))

    def loads(self, held: list[Push], turn: Array) -> tuple[Array, Array]:
        """Return force and moment about the body origin, in body axes."""
        force, moment = np.zeros(3), np.zeros(3)
        for push in held:
            f, t = np.array(push.force), np.array(push.torque)
            place = self.CENTER
            if push.frame == "world":
                f, t = turn.T @ f, turn.T @ t
            elif push.frame == "tool":
                axes, place = turn_matrix(self.FRAME_AXES), self.FRAME_PLACE
                f, t = axes @ f, axes @ t
            force, moment = force + f, moment + t + np.cross(place, f)
        return force, moment

    def derivative(self, y: Array, held: list[Push]) -> Array:
        q, w, v = y[0:4], y[4:7], y[10:13]
        turn = turn_matrix(q)
        force, moment = self.loads(held, turn)
        m, c, inertia = self.MASS, self.CENTER, self.inertia_at_origin()
        skew = np.array([[0.0, -c[2], c[1]], [c[2], 0.0, -c[0]], [-c[1], c[0], 0.0]])
        system = np.block([[m * np.eye(3), -m * skew], [m * skew, inertia]])
        right = np.concatenate([force - m * np.cross(w, np.cross(w, c)), moment - np.cross(w, inertia @ w)])
        solved = np.linalg.solve(system, right)
        q_dot = 0.5 * np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])
        return np.concatenate([q_dot, solved[3:], v, turn @ solved[:3]])

    def states(self, times: list[float]) -> dict[float, Array]:
        x, y, z, w = self.INITIAL.orientation_xyzw
        state = np.concatenate(
            [
                [w, x, y, z],
                self.INITIAL.angular_velocity_body,
                self.INITIAL.position_world,
                self.INITIAL.linear_velocity_world,
            ]
        )
        found = {0.0: state}
        edges = sorted({*times, *(p.start for p in self.PUSHES), self.END})
        for start, end in zip([0.0, *edges], edges, strict=False):
            if end > start:
                latest = {p.channel: p for p in self.PUSHES if p.start <= start}
                held = list(latest.values())
                solution = solve_ivp(
                    lambda _, u, held=held: self.derivative(u, held),
                    (start, end),
                    state,
                    "DOP853",
                    rtol=1e-13,
                    atol=1e-15,
                )
                state = solution.y[:, -1]
                found[end] = state
        return found

    def scene(self, solver: Solver) -> Scene:
        w, x, y, z = self.FRAME_AXES.tolist()
        body = RigidBody.from_matrix(self.MASS, self.INERTIA.tolist(), self.CENTER.tolist())
        tool = FixedFrame(tuple(self.FRAME_PLACE.tolist()), (x, y, z, w))
        frames = WrenchFrames(fixed={"tool": tool}, center_of_mass=body.center_of_mass)
        return Scene(body, frames, self.INITIAL, (Channel("a"), Channel("b"), Channel("c")), solver, self.END, 4.0)

    @pytest.mark.parametrize(
        ("solver", "tolerance"),
        [
            pytest.param(Solver("rkmk4", step=0.001), 2e-12, id="rkmk4"),
            pytest.param(Solver("rk4", step=0.001), 4e-12, id="rk4"),
            pytest.param(Solver("midpoint", step=0.001), 4e-6, id="midpoint"),
            pytest.param(Solver("auto", accuracy=1e-9), 4e-9, id="auto"),
        ],
    )
    def test_every_frame_and_edge(self, solver: Solver, tolerance: float) -> None:
        for name, error in self.deviations(solver).items():
            assert error <= tolerance, name

    def deviations(self, solver: Solver) -> dict[str, float]:
        """Return how far the two are apart at most, over all samples."""
        commands = [(p.channel, Wrench(p.force, p.torque, p.frame, round(p.start * SECOND))) for p in self.PUSHES]
        recorder = Recorder()
        simulate(self.scene(solver), commands, [recorder])
        expected = self.states([s.time_ns / SECOND for s in recorder.samples])

        assert len(recorder.samples) == 13
        found = [apart(sample, *np.split(expected[sample.time_ns / SECOND], (4, 7, 10))) for sample in recorder.samples]
        return largest(found)


class TestPointMasses:
    """Four point masses at constant distances, each under its own force: Newton's law and six constraints.

    No rotation, no inertia matrix, no torque appears: x_i'' = (f_i + sum_j s_ij (x_i - x_j)) / m_i with the tensions
    s_ij that keep all |x_i - x_j|. The forces: on the mass 0 one that turns with the body, on all one in world axes,
    shared by mass, and on the masses 1 and 2 a couple.
    """

    MASSES = np.array([1.0, 2.0, 1.5, 0.7])
    PLACES = np.array([[0.5, 0.1, -0.2], [-0.4, 0.6, 0.1], [0.0, -0.5, 0.3], [0.2, 0.1, 0.9]])  # from the body origin
    PAIRS = tuple((i, j) for i in range(4) for j in range(i))
    FORCE_BODY = np.array([0.8, -0.5, 0.6])
    FORCE_WORLD = np.array([-0.3, 0.4, 0.2])
    INITIAL = State(
        position_world=(0.3, -0.2, 0.1), linear_velocity_world=(0.1, 0.2, -0.1), angular_velocity_body=(0.9, -0.5, 0.7)
    )
    END = 2.0

    def triad(self, x: Array) -> Array:
        """Return the body axes in the world, from the positions of the particles alone."""
        arms = (self.PLACES[1:] - self.PLACES[0]).T
        now = (x[1:] - x[0]).T
        return np.linalg.solve(arms.T, now.T).T

    def forces(self, x: Array) -> Array:
        f = np.outer(self.MASSES / self.MASSES.sum(), self.FORCE_WORLD)
        f[0] += self.triad(x) @ self.FORCE_BODY
        return f

    def derivative(self, y: Array) -> Array:
        x, v = y[:12].reshape(4, 3), y[12:].reshape(4, 3)
        f = self.forces(x)
        jacobian = np.zeros((6, 12))
        curvature = np.zeros(6)
        for row, (i, j) in enumerate(self.PAIRS):
            d = x[i] - x[j]
            jacobian[row, 3 * i : 3 * i + 3], jacobian[row, 3 * j : 3 * j + 3] = d, -d
            curvature[row] = -(v[i] - v[j]) @ (v[i] - v[j])
        inverse = np.repeat(1.0 / self.MASSES, 3)
        tensions = np.linalg.solve(
            jacobian @ (inverse[:, None] * jacobian.T), curvature - jacobian @ (inverse * f.ravel())
        )
        return np.concatenate([y[12:], inverse * (f.ravel() + jacobian.T @ tensions)])

    def test_move_as_the_body_does(self) -> None:
        """Energy and momentum of the body are those of all particles."""
        for name, error in self.deviations().items():
            assert error <= {"place": 2e-11, "speed": 2e-11}.get(name, 1e-10), name

    def deviations(self) -> dict[str, float]:
        """Return how far the particles and the points of the body are apart at most; energies relative."""
        w, v, x = (
            np.array(part)
            for part in (
                self.INITIAL.angular_velocity_body,
                self.INITIAL.linear_velocity_world,
                self.INITIAL.position_world,
            )
        )
        start = np.concatenate([(x + self.PLACES).ravel(), (v + np.cross(w, self.PLACES)).ravel()])
        times = [0.5, 1.0, 1.5, 2.0]
        solution = solve_ivp(
            lambda _, y: self.derivative(y), (0.0, self.END), start, "DOP853", times, rtol=1e-13, atol=1e-14
        )

        recorder = Recorder()
        commands = [
            ("turning", Wrench(tuple(self.FORCE_BODY.tolist()), frame_id="mass0")),
            ("fixed", Wrench(tuple(self.FORCE_WORLD.tolist()), frame_id="world")),
        ]
        simulate(self.scene(), commands, [recorder])

        samples = {s.time_ns / SECOND: s for s in recorder.samples}
        found = []
        for k, time in enumerate(times):
            sample = samples[time]
            xq, yq, zq, wq = sample.orientation_xyzw
            turn = turn_matrix(np.array([wq, xq, yq, zq]))
            places = np.array(sample.position_world) + self.PLACES @ turn.T
            speeds = (
                np.array(sample.linear_velocity_world) + np.cross(sample.angular_velocity_body, self.PLACES) @ turn.T
            )
            energy = 0.5 * float(self.MASSES @ (solution.y[12:, k].reshape(4, 3) ** 2).sum(axis=1))
            momentum = self.MASSES @ solution.y[12:, k].reshape(4, 3)
            found.append(
                {
                    "place": float(np.abs(places.ravel() - solution.y[:12, k]).max()),
                    "speed": float(np.abs(speeds.ravel() - solution.y[12:, k]).max()),
                    "energy": abs(sample.kinetic_energy / energy - 1.0),
                    "momentum": math.dist(sample.linear_momentum_world, momentum),
                }
            )
        return largest(found)

    def scene(self) -> Scene:
        mass = float(self.MASSES.sum())
        center = self.MASSES @ self.PLACES / mass
        arms = self.PLACES - center
        inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(self.MASSES, arms, strict=True))
        body = RigidBody.from_matrix(mass, inertia.tolist(), center.tolist())
        frames = WrenchFrames(
            fixed={"mass0": FixedFrame(tuple(self.PLACES[0].tolist()))}, center_of_mass=body.center_of_mass
        )
        return Scene(
            body,
            frames,
            self.INITIAL,
            (Channel("turning"), Channel("fixed")),
            Solver("rkmk4", step=0.001),
            self.END,
            2.0,
        )


Bag = dict[str, list[tuple[int, object]]]


@pytest.fixture(scope="module")
def bag(example_dir: Path) -> Bag:
    return read_bag(example_dir / "slew.mcap")


def read_bag(path: Path) -> Bag:
    """Return the messages of a bag by topic, with their stamps; read by rosbags, not by the package."""
    reader = pytest.importorskip("rosbags.highlevel", reason="extra 'test' is not installed")
    typesys = pytest.importorskip("rosbags.typesys", reason="extra 'test' is not installed")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    found: Bag = {}
    with reader.AnyReader([path], default_typestore=store) as messages:
        for connection, _, raw in messages.messages():
            message = messages.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


class TestRecordedFlight:
    """examples/slew.mcap: 60 s flown by the Basilisk simulator, read by rosbags."""

    def commands(self, bag: Bag) -> Iterator[tuple[str, Wrench]]:
        for topic in ("/wrench/body", "/wrench/world"):
            for stamp, message in bag[topic]:
                f, t = message.wrench.force, message.wrench.torque  # type: ignore[attr-defined]
                yield topic, Wrench((f.x, f.y, f.z), (t.x, t.y, t.z), message.header.frame_id, stamp)  # type: ignore[attr-defined]

    @pytest.mark.parametrize(
        ("solver", "tolerance"),
        [
            pytest.param(Solver("rkmk4", step=0.01), 5e-13, id="rkmk4"),
            pytest.param(Solver("rk4", step=0.01), 5e-13, id="rk4"),
            pytest.param(Solver("auto", accuracy=1e-9), 1e-9, id="auto"),
        ],
    )
    def test_is_flown_again(self, bag: Bag, solver: Solver, tolerance: float) -> None:
        for name, error in self.deviations(bag, solver).items():
            assert error <= tolerance, name

    def deviations(self, bag: Bag, solver: Solver) -> dict[str, float]:
        """Return how far the two are apart at most, over all 601 samples."""
        poses, twists = dict(bag["/truth/pose"]), dict(bag["/truth/twist"])
        p, t = poses[0].pose, twists[0].twist  # type: ignore[attr-defined]
        q = p.orientation
        turn = turn_matrix(np.array([q.w, q.x, q.y, q.z]))
        initial = State(
            0,
            (p.position.x, p.position.y, p.position.z),
            (q.x, q.y, q.z, q.w),
            tuple((turn @ [t.linear.x, t.linear.y, t.linear.z]).tolist()),
            (t.angular.x, t.angular.y, t.angular.z),
        )
        inertia = [[0.2975, 0.0021, -0.0008], [0.0021, 0.2930, 0.0013], [-0.0008, 0.0013, 0.3104]]
        flight = scene(
            RigidBody.from_matrix(16.8, inertia),
            initial,
            solver,
            60.0,
            10.0,
            (Channel("/wrench/body"), Channel("/wrench/world")),
        )
        recorder = Recorder()
        simulate(flight, self.commands(bag), [recorder])

        samples = {s.time_ns: s for s in recorder.samples}
        assert len(poses) == len(twists) == 601
        assert set(samples) == set(poses) == set(twists)
        found, travelled = [], 0.0
        for stamp, sample in samples.items():
            pose, twist = poses[stamp].pose, twists[stamp].twist  # type: ignore[attr-defined]
            o, omega = pose.orientation, twist.angular
            other = np.array([o.w, o.x, o.y, o.z])
            place = np.array([pose.position.x, pose.position.y, pose.position.z])
            velocity = turn_matrix(other) @ [twist.linear.x, twist.linear.y, twist.linear.z]
            found.append(apart(sample, other, np.array([omega.x, omega.y, omega.z]), place, velocity))
            travelled = max(travelled, math.dist(place, initial.position_world))
        assert travelled > 1.0
        return largest(found)
