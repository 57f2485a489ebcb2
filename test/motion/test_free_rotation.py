"""The closed form of the free motion against 80 digits, at the extremes of body, spin and time."""

from __future__ import annotations

import json
import math
import random
from dataclasses import fields
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from free_reference import angle, free_rotation

from rb_dynamics import ConvergenceError, RigidBody, State, free_motion
from rb_dynamics.motion import free_rotation as closed_form
from rb_dynamics.motion.free_motion import FreeMotion
from rb_dynamics.numerics import compilation
from rb_dynamics.numerics.elliptic import complete_k, rf, rj, sncndn
from rb_dynamics.numerics.rotation import normalize

EPS = 2.0**-52
NEXT = math.nextafter(1.0, 2.0)
CASES = json.loads((Path(__file__).parent.parent / "verification" / "data" / "free_motion.json").read_text())["cases"]

BODIES = {
    "triaxial": lambda r: [1.0, r.uniform(1.1, 1.4), r.uniform(1.5, 2.0)],
    "needle": lambda r: [(small := 10.0 ** r.uniform(-12.0, -1.0)), 1.0, 1.0 + small * r.uniform(-0.9, 0.9)],
    "plate": lambda r: [(a := r.uniform(0.01, 1.0)), (b := r.uniform(0.01, 1.0)), a + b],
    "oblate": lambda r: [1.0, 1.0, r.uniform(1.0, 2.0)],
    "prolate": lambda r: [r.uniform(1e-6, 1.0), 1.0, 1.0],
    "near a sphere": lambda r: [1.0 + r.choice((-1.0, 1.0)) * 10.0 ** r.uniform(-15.0, -3.0) for _ in range(3)],
    "a unit from a sphere": lambda r: [1.0, NEXT, math.nextafter(NEXT, 2.0)],
    "a unit from oblate": lambda r: [1.0, NEXT, r.uniform(1.1, 1.9)],
    "a unit from prolate": lambda r: [r.uniform(0.01, 0.9), 1.0, NEXT],
    "sphere": lambda r: [1.0, 1.0, 1.0],
}


def on_an_axis(r: random.Random, moments: list[float]) -> list[float]:
    axis = r.randrange(3)
    return [r.gauss(0.0, 1.0) * (k == axis) for k in range(3)]


def near_an_axis(r: random.Random, moments: list[float]) -> list[float]:
    off = 10.0 ** r.uniform(-12.0, -3.0)
    spin = [off * r.gauss(0.0, 1.0) for _ in range(3)]
    low, middle, high = sorted(range(3), key=lambda k: moments[k])
    spin[r.choice((low, middle, middle, middle, high))] = 1.0
    return spin


def near_the_separatrix(r: random.Random, moments: list[float]) -> list[float]:
    low, middle, high = sorted(range(3), key=lambda k: moments[k])
    spin = [r.gauss(0.0, 1.0) for _ in range(3)]
    i, j, k = moments[low], moments[middle], moments[high]
    if k > j:
        off = r.choice((0.0, 1e-15, -1e-15, 1e-10, -1e-8))
        spin[high] = spin[low] * math.sqrt(i * (j - i) / (k * (k - j))) * (1.0 + off)
    return spin


SPINS = {
    "any": lambda r, moments: [r.gauss(0.0, 1.0) for _ in range(3)],
    "on an axis": on_an_axis,
    "near an axis": near_an_axis,
    "near the separatrix": near_the_separatrix,
    "slow": lambda r, moments: [1e-12 * r.gauss(0.0, 1.0) for _ in range(3)],
    "fast": lambda r, moments: [1e6 * r.gauss(0.0, 1.0) for _ in range(3)],
    "none": lambda r, moments: [0.0, 0.0, 0.0],
}


@pytest.mark.parametrize("spin_kind", SPINS)
@pytest.mark.parametrize("body_kind", BODIES)
def test_attitude_energy_and_momentum_at_the_extremes(body_kind: str, spin_kind: str) -> None:
    r = random.Random(f"{body_kind} {spin_kind}")
    for longest in (1e-3, 1.0, 1e2, 1e5, 1e9):
        moments = BODIES[body_kind](r)
        r.shuffle(moments)
        spin = SPINS[spin_kind](r, moments)
        t = longest * r.random()

        turn, omega = closed_form.free_rotation((*moments,), (*spin,), t)

        expected, _ = free_rotation(moments, spin, t)
        rate = math.hypot(*spin)
        assert angle(expected, turn) <= min(math.pi, 100.0 * EPS * (1.0 + rate * t)), (moments, spin, t)
        if rate > 0.0:
            for power in (1, 2):
                now = sum(mp.mpf(i) ** power * mp.mpf(w) ** 2 for i, w in zip(moments, omega, strict=True))
                was = sum(mp.mpf(i) ** power * mp.mpf(w) ** 2 for i, w in zip(moments, spin, strict=True))
                assert abs(now / was - 1) <= 20.0 * EPS, (moments, spin, t)


@pytest.mark.parametrize("name", CASES)
def test_references_of_34_digits(name: str) -> None:
    case = CASES[name]
    body = RigidBody.from_matrix(case["mass"], case["inertia"])
    start = State(
        linear_velocity_world=tuple(case["linear_velocity_world"]),
        angular_velocity_body=tuple(case["angular_velocity_body"]),
    )
    times = [state["t"] for state in case["states"]]

    motion = free_motion(body, start, times)

    for k, state in enumerate(case["states"]):
        w, x, y, z = (mp.mpf(c) for c in state["q"])
        bound = 100.0 * EPS * (1.0 + math.hypot(*start.angular_velocity_body) * state["t"])
        assert angle((x, y, z, w), motion.orientation_xyzw[k]) <= bound
        assert np.abs(motion.angular_velocity_body[k] - np.array(state["w"], dtype=float)).max() <= bound
        assert motion.position_world[k] == pytest.approx([float(c) for c in state["x"]], rel=2 * EPS)


def test_times_of_any_shape_and_sign() -> None:
    body = RigidBody.from_matrix(2.0, [[1.0, 0.1, 0.0], [0.1, 2.0, 0.2], [0.0, 0.2, 2.5]], (0.1, 0.2, 0.3))
    start = State(0, (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5), (0.1, 0.0, 0.0), (0.3, -0.2, 0.7))
    grid = free_motion(body, start, [[0.0, 1.0], [2.0, -1.0]])
    assert grid.orientation_xyzw.shape == (2, 2, 4)
    assert free_motion(body, start, 2.0).position_world == pytest.approx(grid.position_world[1, 0], rel=1e-15)
    # There and back again.
    then = free_motion(body, start, 3.0)
    moved = State(0, *(tuple(getattr(then, name).tolist()) for name in State.__slots__[1:]))
    back = free_motion(body, moved, -3.0)
    assert back.position_world == pytest.approx(start.position_world, rel=1e-14)
    assert back.angular_velocity_body == pytest.approx(start.angular_velocity_body, rel=1e-13)
    assert free_motion(body, start, []).position_world.shape == (0, 3)


@pytest.mark.parametrize("t", [math.inf, math.nan, 1e300])
def test_a_time_without_an_answer_is_refused(t: float) -> None:
    body = RigidBody.from_diagonal(1.0, (1.0, 2.0, 3.0))
    with pytest.raises(ConvergenceError, match="finite times"):
        free_motion(body, State(angular_velocity_body=(0.1, 2.0, 0.1)), t)


def test_a_position_beyond_the_range_of_numbers_is_refused() -> None:
    with pytest.raises(ConvergenceError, match="position is not a finite number"):
        free_motion(RigidBody.particle(1.0), State(linear_velocity_world=(1e200, 0.0, 0.0)), [1.0, 1e200])


@pytest.mark.skipif(not compilation.available(), reason="nothing to compare with: numba is not installed")
def test_compiled_has_the_bits_of_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    found: dict[str, list[object]] = {}
    for when in ("never", "always"):
        monkeypatch.setenv("RB_DYNAMICS_COMPILE", when)
        found[when] = [end(body, spin, seed) for seed in range(8) for body in BODIES for spin in SPINS]

    assert found["always"] == found["never"]
    assert sum(isinstance(one, str) for one in found["never"]) > 500
    assert any(isinstance(one, tuple) for one in found["never"])


def end(body_kind: str, spin_kind: str, seed: int) -> object:
    """Return the ends of some free motions, bit for bit, or their errors."""
    r = random.Random(f"{body_kind} {spin_kind} {seed}")
    moments = BODIES[body_kind](r)
    r.shuffle(moments)
    turn = normalize((r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0)))
    arm, position, velocity = ((r.gauss(0.0, 1.0), r.gauss(0.0, 1.0), r.gauss(0.0, 1.0)) for _ in range(3))
    spin = SPINS[spin_kind](r, moments)
    body = RigidBody.from_matrix(10.0 ** r.uniform(-3.0, 3.0), np.diag(moments).tolist(), arm)
    times = [10.0 ** r.uniform(-3.0, 9.5) * r.choice((-1.0, 1.0)) for _ in range(4)]
    try:
        motion = free_motion(body, State(0, position, turn, velocity, (spin[0], spin[1], spin[2])), times)
    except ConvergenceError as error:
        return str(error), times
    # By repr, which shows the sign of a zero too.
    return repr([getattr(motion, field.name).tolist() for field in fields(FreeMotion)])


def test_elliptic_functions_and_integrals() -> None:
    r = random.Random(1)
    with mp.workdps(40):
        for _ in range(300):
            m1 = 10.0 ** r.uniform(-18.0, 0.0)
            m = 1 - mp.mpf(m1)
            assert abs(complete_k(m1) / mp.ellipk(m) - 1) <= 5.0 * EPS
            u = r.uniform(-1.0, 1.0) * complete_k(m1)
            for name, value in zip(("sn", "cn", "dn"), sncndn(u, m1), strict=True):
                assert abs(value - mp.ellipfun(name, mp.mpf(u), m=m)) <= 4.0 * EPS
            x, y, z, p = (10.0 ** r.uniform(-8.0, 2.0) for _ in range(4))
            assert abs(rf(x, y, z) / mp.elliprf(x, y, z) - 1) <= 8.0 * EPS
            assert abs(rj(x, y, z, p) / mp.elliprj(x, y, z, p) - 1) <= 20.0 * EPS
