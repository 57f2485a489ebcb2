"""Momenta, energy and work of a motion, and the defects of their balances: `Sample` and how it is computed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.combined_effects import CombinedEffects
from rb_dynamics.loads.effect import Point, Stored
from rb_dynamics.loads.varying_load import Load
from rb_dynamics.loads.wheel_set import WheelSet
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.equations_of_motion import accelerations
from rb_dynamics.motion.kernel_layout import phase_of
from rb_dynamics.motion.phase_state import PhaseState, inertia_of
from rb_dynamics.numerics.rotation import Quaternion, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, dot, scale, subtract
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


# Error of the energy from which fixed steps count as too long; speed (m/s or rad/s) below which a body is at rest.
_UNBALANCED, _STILL = 0.1, 1e-12

# By the beginning of the names of fields and columns.
_UNITS = {
    "time_ns": "ns",
    "position": "m",
    "linear_velocity": "m/s",
    "linear_acceleration": "m/s^2",
    "linear_momentum": "kg m/s",
    "angular_velocity": "rad/s",
    "angular_acceleration": "rad/s^2",
    "angular_momentum": "kg m^2/s",
    "wheel_speeds": "rad/s",
    **dict.fromkeys(
        ("kinetic_energy", "work", "energy_defect", "potential_energy", "motor_work", "friction_heat"), "J"
    ),
}


def told_speed(speed: float, rate: float) -> float:
    """Return the speed of a wheel (rad/s) for texts: 0 where it is the rounding of the body's `rate` (rad/s).

    It is relative to the body, a total less a rate; that of a wheel at rest is seldom exactly 0.
    """
    return speed if abs(speed) > 1e-15 * abs(rate) else 0.0


def unit_of(name: str) -> str:
    """Return the unit of a field of `Sample`, or of a column of its numbers; "" if it has none."""
    return next((unit for begin, unit in _UNITS.items() if name.startswith(begin)), "")


@dataclass(frozen=True, slots=True)
class Sample:
    """State, momenta, energies and defects at one time; field names are those of `simulate --json`.

    Attributes:
        time_ns: simulation time, integer nanoseconds.
        position_world: of the body origin, m.
        orientation_xyzw: body to world.
        linear_velocity_world: of the body origin, m/s.
        angular_velocity_body: rad/s.
        angular_momentum_world: about the centre of mass, kg m^2/s.
        linear_momentum_world: kg m/s.
        kinetic_energy: translation and rotation, J.
        work: of all loads since the start, J.
        energy_defect: T - T0 - work, J.
        angular_momentum_defect_world: L - L0 - integral of N dt, kg m^2/s.
        linear_momentum_defect_world: p - p0 - integral of F dt, kg m/s.
        potential_energy: of the effects that have one, J; None if no effect has one.
        wheel_speeds: of the reaction wheels relative to the body, rad/s; None without wheels.
        motor_work: of the motors of the wheels since the start, J; included in `work`.
        friction_heat: of the wheels since the start, J; subtracted in `work`.
    """

    time_ns: int
    position_world: Vector
    orientation_xyzw: Quaternion
    linear_velocity_world: Vector
    angular_velocity_body: Vector
    angular_momentum_world: Vector
    linear_momentum_world: Vector
    kinetic_energy: float
    work: float
    energy_defect: float
    angular_momentum_defect_world: Vector
    linear_momentum_defect_world: Vector
    potential_energy: float | None = None
    wheel_speeds: tuple[float, ...] | None = None
    motor_work: float | None = None
    friction_heat: float | None = None


def too_long(step: float | None, body: RigidBody, kinetic_energy: float, work: float, defect: float) -> str:
    """Return that fixed steps (s) put the energy of a motion off by a tenth or more; "" if not, or without `step`."""
    largest = max(kinetic_energy, abs(work), abs(kinetic_energy - work - defect))
    # Of a body that hardly moves, all of this is rounding.
    hardly = 0.5 * _STILL * _STILL * (body.mass + sum(body.principal_moments))
    if step is None or largest <= hardly or abs(defect) <= _UNBALANCED * largest:
        return ""
    return (
        f"the energy of the motion is off by {100.0 * abs(defect) / largest:.3g} %: steps of {step:g} s are too long "
        "for it; take shorter ones, or give solver.accuracy"
    )


def kinetic_energy(body: RigidBody, phase: PhaseState) -> float:
    """Return T = p . p / 2m + w . I w / 2, J: translation (lecture 24, page 6) and rotation (eq. 26)."""
    momentum, omega = phase.linear_momentum_world, phase.angular_velocity
    return 0.5 * (dot(momentum, scale(1.0 / body.mass, momentum)) + dot(omega, times(body.principal_moments, omega)))


class SampleBuilder:
    """Computes samples: state, momenta, energies and the defects of their balances."""

    def __init__(self, effects: CombinedEffects, phase: PhaseState, wheels: WheelSet | None = None) -> None:
        """Measure defects from `phase` on; `effects` act on their body in addition to the wrenches."""
        self._wheels, self._inner = wheels, (0.0, ZERO)
        if wheels is not None:
            inner = wheels.stored(phase.angular_velocity, phase.inner)
            self._inner = inner.energy, rotate(phase.orientation, inner.momentum)
        self._effects, self._body = effects, effects.body
        body = effects.body
        self._potential, self._storing = effects.potential(), effects.storing()
        self._energy = kinetic_energy(body, phase)
        self._spin, self._momentum = phase.angular_momentum_world(body), phase.linear_momentum_world
        self._stored = self._storing(phase.point(body)).energy if self._storing else 0.0

    def sample(self, phase: PhaseState, time_ns: int) -> Sample:
        """Return the sample of the body in `phase`.

        The defects are the raw residuals of the balances T - T0 = W (lecture 24, page 8), L - L0 = int N dt (page 18)
        and p - p0 = int F dt (page 6), with W and the impulses by the method's own quadrature: they must not be
        projected or smoothed. Parts that move inside the body count in L and T. Their inner torque is accumulated with
        the others; integrated by parts it gives the change of their own momentum and the work of their motor, which
        therefore cancel in the defects.
        """
        stored = None if self._storing is None else self._storing(phase.point(self._body))
        found = self._without_potential(phase, time_ns, stored)
        return replace(found, potential_energy=self._potential(phase.point(self._body))) if self._potential else found

    def _without_potential(self, phase: PhaseState, time_ns: int, stored: Stored | None) -> Sample:
        body = self._body
        state = phase.state(body, time_ns)
        energy, work = kinetic_energy(body, phase), phase.work
        spin, momentum = phase.angular_momentum_world(body), phase.linear_momentum_world
        energy_defect = energy - self._energy - work
        spin_defect = subtract(subtract(spin, self._spin), phase.torque_impulse_world)
        if stored is not None:
            energy, work = energy + stored.energy, work + (stored.energy - self._stored)
            spin = add(spin, rotate(phase.orientation, stored.momentum))
        speeds = motor = heat = None
        if self._wheels is not None:
            # Motors and friction do work on body and wheels; their inner torque exchanges momentum between the two.
            states = phase.inner
            inner = self._wheels.stored(phase.angular_velocity, states)
            motor, heat, power, impulse = self._wheels.booked(states)
            held = rotate(phase.orientation, inner.momentum)
            energy, work, spin = energy + inner.energy, work + power, add(spin, held)
            energy_defect += inner.energy - self._inner[0] - power
            spin_defect = add(spin_defect, add(subtract(held, self._inner[1]), impulse))
            speeds = self._wheels.speeds(phase.angular_velocity, states)
        return Sample(
            time_ns=time_ns,
            position_world=state.position_world,
            orientation_xyzw=state.orientation_xyzw,
            linear_velocity_world=state.linear_velocity_world,
            angular_velocity_body=state.angular_velocity_body,
            angular_momentum_world=spin,
            linear_momentum_world=momentum,
            kinetic_energy=energy,
            work=work,
            energy_defect=energy_defect,
            angular_momentum_defect_world=spin_defect,
            linear_momentum_defect_world=subtract(subtract(momentum, self._momentum), phase.impulse_world),
            wheel_speeds=speeds,
            motor_work=motor,
            friction_heat=heat,
        )

    def samples(self, phase: PhaseState, times_ns: npt.NDArray[np.int64]) -> Sample:
        """Return the samples of the body in many phases, as one sample of arrays, with the same bits as one by one.

        `phase` has arrays in place of numbers. For scenes with wheels use `sample`.
        """
        import numpy as np

        stored = None if self._storing is None else self._effects.stored_at(phase.point(self._body))
        if self._storing is not None and stored is None:
            momenta, energies = zip(*map(self._storing, self._points(phase)), strict=True)
            stored = Stored(cast("Vector", tuple(np.array(momenta).T)), cast("float", np.array(energies)))
        # An energy beyond the range of doubles becomes infinite, as elsewhere.
        with np.errstate(all="ignore"):
            found = self._without_potential(phase, cast("int", times_ns), stored)
        if self._potential is None:
            return found
        potentials = self._effects.potentials(phase.point(self._body))
        if potentials is None:
            potentials = np.array([self._potential(point) for point in self._points(phase)])
        return replace(found, potential_energy=cast("float", potentials))

    def _points(self, phase: PhaseState) -> list[Point]:
        """Return the point of each of many phases."""
        columns: Any = (*phase.orientation, *phase.angular_velocity, *phase.high, *phase.low)
        return [phase_of(row).point(self._body) for row in zip(*(n.tolist() for n in columns), strict=True)]


def torque_impulse(first: Sample, sample: Sample) -> Vector:
    """Return the impulse of the torque from outside since the `first` sample, without what went into internal parts."""
    gained = subtract(sample.angular_momentum_world, first.angular_momentum_world)
    return subtract(gained, sample.angular_momentum_defect_world)


def acceleration(
    body: RigidBody, phase: PhaseState, held: HeldWrench, load: Load | None = None
) -> tuple[Vector, Vector]:
    """Return `accelerations` under `held` (body parts in principal axes) and `load`.

    They are the true ones, not differences of velocities.
    """
    omega, moments, axes = phase.angular_velocity, inertia_of(body).moments, body.principal_orientation_xyzw
    torque = add(held.torque_body, rotate_inverse(phase.orientation, held.torque_world))
    push = held.force_world
    if load is not None:
        velocity = scale(1.0 / body.mass, phase.linear_momentum_world)
        varying_force, varying_torque = load(0.0, ZERO, velocity, phase.orientation, omega)
        push, torque = add(push, varying_force), add(torque, varying_torque)
    forces = held.force_body, push
    return accelerations(body.mass, moments, body.center_of_mass, axes, phase.orientation, omega, forces, torque)
