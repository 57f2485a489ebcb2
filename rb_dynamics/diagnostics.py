"""What a motion has: momenta, energy, work and the defects of their balances. Never changes a state."""

from __future__ import annotations

from dataclasses import dataclass

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.phase import Phase
from rb_dynamics.rotation import Quaternion, rotate, rotate_inverse
from rb_dynamics.vector import Vector, add, cross, divide, dot, multiply, scale, subtract


@dataclass(frozen=True, slots=True)
class Sample:
    """State and bookkeeping at one instant; field names are those of `simulate --json`.

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


def kinetic_energy(body: RigidBody, phase: Phase) -> float:
    """Return T = p . p / 2m + w . I w / 2, J: translation (lecture 24, page 6) and rotation (eq. 26)."""
    momentum, omega = phase.linear_momentum_world, phase.angular_velocity
    return 0.5 * (dot(momentum, scale(1.0 / body.mass, momentum)) + dot(omega, multiply(body.principal_moments, omega)))


@dataclass(frozen=True, slots=True)
class Baseline:
    """What the defects of a run are measured from: T0, L0 and p0."""

    kinetic_energy: float
    angular_momentum_world: Vector
    linear_momentum_world: Vector

    @classmethod
    def of(cls, body: RigidBody, phase: Phase) -> Baseline:
        """Return the baseline of a run that begins in `phase`."""
        return cls(kinetic_energy(body, phase), phase.angular_momentum_world(body), phase.linear_momentum_world)


def observe(body: RigidBody, phase: Phase, time_ns: int, baseline: Baseline) -> Sample:
    """Return everything there is to see of `body` in `phase`.

    The defects are the raw residuals of the balances T - T0 = W (lecture 24, page 8), L - L0 = int N dt (page 18) and
    p - p0 = int F dt (page 6), with W and the impulses by the method's own quadrature: never projected, never smoothed.
    """
    state = phase.state(body, time_ns)
    energy = kinetic_energy(body, phase)
    spin, momentum = phase.angular_momentum_world(body), phase.linear_momentum_world
    return Sample(
        time_ns=time_ns,
        position_world=state.position_world,
        orientation_xyzw=state.orientation_xyzw,
        linear_velocity_world=state.linear_velocity_world,
        angular_velocity_body=state.angular_velocity_body,
        angular_momentum_world=spin,
        linear_momentum_world=momentum,
        kinetic_energy=energy,
        work=phase.work,
        energy_defect=energy - baseline.kinetic_energy - phase.work,
        angular_momentum_defect_world=subtract(
            subtract(spin, baseline.angular_momentum_world), phase.torque_impulse_world
        ),
        linear_momentum_defect_world=subtract(subtract(momentum, baseline.linear_momentum_world), phase.impulse_world),
    )


def acceleration(body: RigidBody, phase: Phase, held: HeldWrench) -> tuple[Vector, Vector]:
    """Return the linear acceleration of the body origin (m/s^2) and the angular one (rad/s^2), both in body axes.

    Euler's equations (lecture 24, eqs. 18 and 19) and F = m dv/dt under `held` (body parts in principal axes): the true
    acceleration, not a difference of velocities.
    """
    omega, moments, axes = phase.angular_velocity, body.principal_moments, body.principal_orientation_xyzw
    torque = add(held.torque_body, rotate_inverse(phase.orientation, held.torque_world))
    omega_dot = rotate(axes, divide(subtract(torque, cross(omega, multiply(moments, omega))), moments))
    force = rotate(axes, add(held.force_body, rotate_inverse(phase.orientation, held.force_world)))
    spin, arm = rotate(axes, omega), body.center_of_mass
    turning = add(cross(omega_dot, arm), cross(spin, cross(spin, arm)))
    return subtract(scale(1.0 / body.mass, force), turning), omega_dot
