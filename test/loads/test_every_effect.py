"""Properties of every effect of this package, tested in its scene in config/; new effects are included.

A wrong sign in an effect does not show in its books, because the booked load is the applied one. It shows here:
against the potential of the effect, the momentum stored in the body, or because a resistance must take energy out.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motions import Recorder

import rb_dynamics as rb
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.effect import Effect, Point
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.phase_state import in_principal_axes
from rb_dynamics.numerics.rotation import exp, multiply, normalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, dot, norm, scale, subtract

CONFIG = Path(__file__).parents[2] / "config"
AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

# These have no potential, store nothing and resist nothing; test_effects.py holds each to its sign.
DRIVES = {"scheduled_wrench"}

each_kind = pytest.mark.parametrize("kind", EFFECTS.own)


def shown(kind: str) -> rb.Scene:
    """Return the scene that shows `kind`, with that alone, and at most 20 s of it."""
    paths = sorted(sorted(CONFIG.glob("*.yaml")), key=lambda path: path.stem != kind)
    found = [path for path in paths if f"type: {kind}" in path.read_text(encoding="utf-8")]
    assert found, f"no scene of config/ shows {kind}; write config/{kind}.yaml"
    scene = rb.read_scene(found[0])
    effects = tuple(effect for effect in scene.effects if effect.kind == kind)
    return replace(scene, effects=effects, duration=min(scene.duration or 20.0, 20.0), output_rate=1.0)


def points() -> Iterator[Point]:
    """Yield states at time 0, a few metres from the origin, fast and turning."""
    draw = random.Random(7)

    def vector(size: float) -> Vector:
        return (draw.gauss(0.0, size), draw.gauss(0.0, size), draw.gauss(0.0, size))

    while True:
        position = vector(3.0)
        if norm(position) > 1.0:
            yield Point(0.0, position, vector(30.0), exp(vector(2.0)), vector(5.0))


def acting(effect: Effect, scene: rb.Scene, point: Point) -> tuple[Vector, Vector]:
    """Return force (world axes) and torque (principal axes) of an effect at time 0, whether held or not."""
    schedules = CombinedEffects(scene.body, (effect,), scene.frames).schedules()
    begun = [wrench for _, entries in schedules for time, wrench in entries if time <= 0.0]
    held = in_principal_axes(scene.body, scene.frames.hold(begun[-1]) if begun else HeldWrench())
    force = add(held.force_world, rotate(point.orientation, held.force_body))
    torque = add(held.torque_body, rotate_inverse(point.orientation, held.torque_world))
    inside = effect.wrenching(scene.body, 0.0)
    more_force, more_torque = inside(point) if inside is not None else (ZERO, ZERO)
    return add(force, more_force), add(torque, more_torque)


@each_kind
def test_force_and_torque_are_the_slope_of_the_potential(kind: str) -> None:
    scene, h = shown(kind), 1e-4
    for effect in scene.effects:
        potential = effect.potential(scene.body)
        if potential is None:
            continue
        for _, point in zip(range(20), points(), strict=False):

            def moved(step: Vector, point: Point = point) -> Point:
                return point._replace(position=add(point.position, step))

            def turned(step: Vector, point: Point = point) -> Point:
                return point._replace(orientation=normalize(multiply(point.orientation, exp(step))))

            size = 1e-9 * abs(potential(point))
            for found, change in zip(acting(effect, scene, point), (moved, turned), strict=True):
                slopes = [
                    (potential(change(scale(h, axis))) - potential(change(scale(-h, axis)))) / (2.0 * h)
                    for axis in AXES
                ]
                assert found == pytest.approx([-slope for slope in slopes], abs=1e-5 * norm(found) + size)


@each_kind
def test_the_potential_at_many_points_is_that_at_each(kind: str) -> None:
    scene = shown(kind)
    effects = scene.combined_effects
    potential, storing = effects.potential(), effects.storing()
    if not all(effect.takes_arrays for effect in scene.effects):
        return
    # At 1e150 m the sum of the squares of lengths is near the end of the range of doubles.
    some = [point._replace(time=2.0 * k) for k, point in zip(range(50), points(), strict=False)]
    some += [point._replace(position=scale(size, point.position)) for point in some[:5] for size in (1e-3, 1e150)]
    time, *rows = zip(*some, strict=True)
    together = Point(np.array(time), *(tuple(np.array(row).T) for row in rows))  # type: ignore[arg-type]
    if potential is not None:
        found = effects.potentials(together)
        assert found is not None
        assert found.tolist() == [potential(point) for point in some]
    if storing is not None:
        stored, each = effects.stored_at(together), [storing(point) for point in some]
        assert stored is not None
        assert np.broadcast_to(stored.energy, len(some)).tolist() == [one.energy for one in each]
        momenta = [np.broadcast_to(row, len(some)).tolist() for row in stored.momentum]
        assert list(zip(*momenta, strict=True)) == [one.momentum for one in each]


def test_a_potential_that_is_not_finite_somewhere_is_left_to_the_points() -> None:
    scene = shown("central_gravity")
    assert scene.combined_effects.potentials(Point(np.zeros(2), *[(np.zeros(2),) * 3] * 2, (0, 0, 0, 1), ZERO)) is None  # type: ignore[arg-type]


@each_kind
def test_the_books_close(kind: str) -> None:
    recorder = Recorder()
    rb.simulate(shown(kind), sinks=[recorder])
    samples = recorder.samples

    energy = max(sample.kinetic_energy + abs(sample.work) for sample in samples)
    spin = max(norm(sample.angular_momentum_world) for sample in samples)
    momentum = max(norm(sample.linear_momentum_world) for sample in samples)
    for sample in samples:
        assert abs(sample.energy_defect) <= 1e-7 * energy
        assert norm(sample.angular_momentum_defect_world) <= 1e-7 * spin
        assert norm(sample.linear_momentum_defect_world) <= 1e-7 * momentum


@each_kind
def test_energy_and_momentum_go_where_the_effect_says(kind: str) -> None:
    """They go into the potential, into moving parts inside the body, or are dissipated."""
    scene, recorder = shown(kind), Recorder()
    (effect, *_) = scene.effects
    rb.simulate(scene, sinks=[recorder])
    start, *samples = recorder.samples

    if start.potential_energy is not None:
        whole = [sample.kinetic_energy + (sample.potential_energy or 0.0) for sample in (start, *samples)]
        most = max(sample.kinetic_energy for sample in samples) + abs(start.potential_energy)
        assert max(abs(each - whole[0]) for each in whole) <= 1e-7 * most
    elif effect.storing(scene.body) is not None:
        kept = start.angular_momentum_world
        lost = max(norm(subtract(sample.angular_momentum_world, kept)) for sample in samples)
        assert lost <= 1e-7 * norm(kept), "the momentum of the body with what moves inside it is not kept"
    elif kind not in DRIVES:
        for _, point in zip(range(20), points(), strict=False):
            force, torque = acting(effect, scene, point)
            resists = dot(force, point.velocity) <= 0.0 and dot(torque, point.angular_velocity) <= 0.0
            assert resists, f"{kind} puts energy in; if it should, name it in DRIVES and test it in test_effects.py"
