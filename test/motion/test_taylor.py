"""The Taylor method drops only terms below round-off."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from rb_dynamics.loads.wrench import HeldWrench, Wrench
from rb_dynamics.motion import Increment, Inertia, taylor
from rb_dynamics.numerics.rotation import Quaternion, normalize
from rb_dynamics.numerics.vector import ZERO, Vector, scale
from rb_dynamics.run.simulate import simulate
from rb_dynamics.scene.read import parse_scene

EPS = 2.0**-52


def case(seed: int) -> tuple[Inertia, HeldWrench, Vector, Quaternion, Vector]:
    """Return a body, what acts on it, and its velocity, attitude and angular velocity; every fourth is at rest."""
    r = random.Random(seed)

    def vector() -> Vector:
        return (r.uniform(-1.0, 1.0), r.uniform(-1.0, 1.0), r.uniform(-1.0, 1.0))

    a, b = r.uniform(0.3, 3.0), r.uniform(0.3, 3.0)
    held = HeldWrench(*(vector() if r.random() < 0.8 else ZERO for _ in range(3)), vector())
    spin = ZERO if seed % 4 == 0 else scale(10.0 ** r.uniform(-3.0, 1.0), vector())
    orientation = normalize((*vector(), r.uniform(-1.0, 1.0)))
    return Inertia(r.uniform(0.1, 10.0), (a, b, r.uniform(abs(a - b), a + b))), held, vector(), orientation, spin


def step_of(seed: int, turn: float) -> Increment:
    """Return a step of `turn` at the rate of the motion."""
    inertia, held, velocity, orientation, omega = case(seed)
    return taylor.step(inertia, held, turn / taylor._rate(inertia, held, omega), velocity, orientation, omega)


@pytest.mark.parametrize("order", [6, 8, 10])
def test_a_short_step_has_the_bits_of_all_terms(monkeypatch: pytest.MonkeyPatch, order: int) -> None:
    """Close to the longest short step, where most terms are left out."""
    turn = 0.999 * (0.5 * EPS) ** (1.0 / order)
    assert taylor._order(turn) == order
    found = [repr(step_of(seed, turn)) for seed in range(500)]
    monkeypatch.setattr(taylor, "_order", lambda turn: taylor._ORDER)
    with_all = [repr(step_of(seed, turn)) for seed in range(500)]

    # In one case in a thousand a sum is so near the middle of two numbers that it is rounded the other way.
    assert sum(a != b for a, b in zip(found, with_all, strict=True)) <= 2


def test_a_longer_step_takes_all_terms() -> None:
    assert [taylor._order(turn) for turn in (0.05, 1.0, math.inf, math.nan)] == [taylor._ORDER] * 4


def test_the_terms_left_out_are_below_rounding_in_the_worst_case() -> None:
    """By the equation that bounds every coefficient: rate and torque as large as they may be, all aligned."""
    rate, torque, matrix = [1.0], [1.0], [1.0]
    for k in range(60):

        def product(a: list[float], b: list[float], k: int = k) -> float:
            return math.fsum(a[j] * b[k - j] for j in range(k + 1))

        rate_dot, torque_dot = product(rate, rate) / math.sqrt(3.0) + torque[k], product(torque, rate)
        matrix.append(product(matrix, rate) / (k + 1))
        rate.append(rate_dot / (k + 1))
        torque.append(torque_dot / (k + 1))
    for order in (6, 8, 10):
        turn = (0.5 * EPS) ** (1.0 / order)
        assert math.fsum(c * turn**k for k, c in enumerate(rate) if k > order) <= EPS
        assert math.fsum(c * turn**k / (k + 1) for k, c in enumerate(matrix) if k > order) <= EPS


def test_times_inside_a_step_share_its_expansion() -> None:
    """As for outputs: the expensive part is cached."""
    taylor._expand.cache_clear()
    for h in (0.1, 0.11, 0.12, 0.13):
        inertia, held, velocity, orientation, _ = case(1)
        taylor.step(inertia, held, h, velocity, orientation, (0.4, 0.8, 0.1))
    found = taylor._expand.cache_info()

    assert (found.misses, found.hits) == (1, 3)


def test_so_they_do_in_kernels_with_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the memory held the expansion of another start, under other loads."""
    starts: list[object] = []
    write = taylor._write
    monkeypatch.setattr(taylor, "_write", lambda m, start, order: [starts.append(start), write(m, start, order)][1])
    assert taylor.TAYLOR.dense is not None
    memory = np.zeros(taylor.TAYLOR.dense.size)
    for seed in range(100):
        inertia, held, velocity, orientation, omega = case(seed)
        rate = taylor._rate(inertia, held, omega)
        motion = velocity, orientation, omega
        times = [turn / rate for turn in (1e-5, 0.3, 0.0001, 0.02, 0.2)]
        del starts[:]
        found = [taylor.TAYLOR.dense.step(inertia, held, h, *motion, memory) for h in times]
        assert len(starts) == 1

        expected = [taylor.step(inertia, held, h, *motion) for h in times]
        assert [np.hstack(each).tobytes() for each in found] == [np.hstack(each).tobytes() for each in expected]


@pytest.mark.parametrize("seed", range(0, 80, 4))
def test_the_work_is_what_the_energy_grows_by(seed: int) -> None:
    """From rest, where no digits cancel."""
    inertia, step = case(seed)[0], step_of(seed, 0.01)

    energies = [p * p / inertia.mass for p in step.impulse]
    energies += [i * w * w for i, w in zip(inertia.moments, step.angular_velocity, strict=True)]
    work = step.work - math.fsum(p * v for p, v in zip(step.impulse, case(seed)[2], strict=True))

    assert work == pytest.approx(0.5 * math.fsum(energies), rel=1e-13)


@pytest.mark.parametrize("method", ["auto", "taylor"])
@pytest.mark.parametrize("accuracy", [1e-3, 1e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("duration", [5.3, 10.0])
def test_the_accuracy_holds_for_the_position_too(method: str, accuracy: float, duration: float) -> None:
    """A force turns with a body that spins steadily, and leads it around a circle: an error of the velocity remains."""
    scene = parse_scene(f"""
        body: {{mass: 1, inertia: {{diagonal: [1, 1, 1]}}}}
        initial: {{linear_velocity_world: [0, -1, 0], angular_velocity_body: [0, 0, 1]}}
        solver: {{method: {method}, accuracy: {accuracy}}}
        duration: {duration}
    """)
    end = simulate(scene, [("wrench", Wrench(force=(1.0, 0.0, 0.0), torque=ZERO))]).sample.position_world
    x, y = 1.0 - math.cos(duration), -math.sin(duration)
    assert math.hypot(end[0] - x, end[1] - y) < accuracy * duration
