"""A reaction wheel: a motor turns it against the body, by a commanded torque or to a commanded speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.body.principal_axes import diagonalize
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.loads.actuator import Accepted, Actuator, clipped
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.number_ranges import Range, check_vector, read_numbers
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.loads.wrench import FASTEST
from rb_dynamics.numerics.argument_checks import number, shown
from rb_dynamics.numerics.rotation import rotate, rotate_inverse
from rb_dynamics.numerics.vector import Vector, divide, dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry

COMMANDS = ("torque", "speed")

NEAR_LIMIT = 0.95
"""Fraction of `max_speed` from which a wheel counts as near it."""

# The part of the body's inertia about any direction that the wheels leave at least: rounding errors of the inertia are
# then less than 1e-9 of what is left.
_LEFT_OVER = 1e-6

# The rate (1/s) of viscous friction up to which steps of some nanoseconds resolve it.
_FASTEST_SLOWING = 1e8


@dataclass(frozen=True, kw_only=True)
class ReactionWheel(Actuator):
    """A wheel whose speed relative to the body is a state of the run.

    Its inertia J about its axis a is contained in the body's inertia I, as CAD gives it. With the speed W relative to
    the body, L = I w + J W a, T = w . I w / 2 + J W a . w + J W^2 / 2, and J (W' + a . w') = u + f: the torque of motor
    and friction on the wheel, whose reaction acts on the body (Hughes, Spacecraft Attitude Dynamics, section 3.4).

    The friction is f = -c sign W - v W; at rest it holds the wheel up to c. A commanded torque u is held until the next
    command. A commanded speed is approached with `max_torque`, and then held with the torque that this takes, up to
    `max_torque`. So is `max_speed`: where the body drives the wheel beyond it, the motor brakes with `max_torque`.

    Attributes:
        axis: body axes; its length does not matter.
        inertia: J, kg m^2.
        command: `torque` (N m, on the wheel about its axis) or `speed` (rad/s relative to the body).
        max_torque: of the motor, in both directions, N m; infinite for no limit. A commanded speed needs a limit.
        max_speed: relative to the body, in both directions, rad/s.
        coulomb: c, N m.
        viscous: v, N m s/rad.
        speed: W at the start, rad/s.
        static_imbalance: U_s, kg m: the force U_s W^2 at `position`, which turns with the wheel.
        dynamic_imbalance: U_d, kg m^2: the torque U_d W^2, which also turns with the wheel.
        phase: direction of force and torque at the start: angle about the axis, rad, from y if the axis is closest to
            x, from z if it is closest to y, from x if it is closest to z, made perpendicular to the axis.
        position: of the wheel, body axes, m, from the body origin; needed with a static imbalance.
    """

    kind: ClassVar[str] = "reaction_wheel"
    takes: ClassVar[LoadDependence] = LoadDependence.STATES
    keys: ClassVar[tuple[str, ...]] = (
        *("name", "axis", "inertia", "command", "max_torque", "max_speed", "friction", "speed"),
        *("imbalance", "position"),
    )
    ranges: ClassVar[Mapping[str, Range]] = {
        "inertia": Range("a number greater than 0 (kg m^2)", "write its inertia about its own axis", above=0.0),
        "coulomb": Range("0 or more (N m)", "write 0 for none", least=0.0),
        "viscous": Range("0 or more (N m s/rad)", "write 0 for none", least=0.0),
        "static_imbalance": Range("0 or more (kg m)", "write 0 for none", least=0.0),
        "dynamic_imbalance": Range("0 or more (kg m^2)", "write 0 for none", least=0.0),
        "phase": Range("a finite number (rad)", "write 0"),
    }

    axis: Vector
    inertia: float
    command: str = "torque"
    max_torque: float = math.inf
    max_speed: float = math.inf
    coulomb: float = 0.0
    viscous: float = 0.0
    speed: float = 0.0
    static_imbalance: float = 0.0
    dynamic_imbalance: float = 0.0
    phase: float = 0.0
    position: Vector | None = None

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range, the axis is zero, or there is no such command.
        """
        super().__post_init__()
        check_vector(self, "axis", "the direction of its axis", direction=True)
        for name in ("max_torque", "max_speed"):
            if (limit := getattr(self, name)) != math.inf:
                expected = "a number greater than 0, infinite for no limit"
                object.__setattr__(
                    self, name, number(limit, f"reaction_wheel: {name}", expected, SceneError, above=0.0)
                )
        limits = {"least": -self.max_speed, "most": self.max_speed}
        speed = number(self.speed, "reaction_wheel: speed", "a speed within max_speed (rad/s)", SceneError, **limits)
        object.__setattr__(self, "speed", speed)
        if self.command not in COMMANDS:
            raise SceneError(f"reaction_wheel: command is {shown(self.command)}, expected {' or '.join(COMMANDS)}")
        if self.command == "speed" and self.max_torque == math.inf:
            raise SceneError(
                "reaction_wheel: max_torque is infinite, expected a finite one for a commanded speed: a wheel cannot "
                "reach a speed at once; write one"
            )
        if self.position is not None:
            check_vector(self, "position", "three finite numbers (m)")
        elif self.static_imbalance:
            raise SceneError(
                "reaction_wheel: position is None, expected that of the wheel: a static imbalance is a force there; "
                "write position=(x, y, z)"
            )

    @classmethod
    def read(cls, entry: SceneEntry) -> ReactionWheel:
        """Return the actuator of an entry."""
        if entry.is_particle:
            entry.reject("no reaction wheel, as a body without inertia is a particle", "add body.inertia or remove it")
        friction = entry.inner("friction", ("coulomb", "viscous"))
        imbalance, position = entry.inner("imbalance", ("static", "dynamic", "phase")), None
        shaking = {}
        if imbalance is not None:
            for name, key in (("static_imbalance", "static"), ("dynamic_imbalance", "dynamic"), ("phase", "phase")):
                expected, remedy, *_ = each = cls.ranges[name]
                shaking[name] = imbalance.number(key, expected, each.holds, remedy, 0.0)
        if entry.has("position") or shaking.get("static_imbalance"):
            position = entry.vector("position", "a finite number (m)")
        limits = {
            name: entry.number(name, f"a number greater than 0 ({unit})", lambda v: v > 0.0, "leave it out for none")
            for name, unit in (("max_torque", "N m"), ("max_speed", "rad/s"))
            if entry.has(name)
        }
        return cls(
            name=entry.name or "wheel",
            axis=entry.direction("axis", "write its axis in the body, such as [1, 0, 0]"),
            command=entry.choice("command", COMMANDS, COMMANDS[0]),
            speed=entry.number("speed", "a finite number (rad/s)", default=0.0),
            position=position,
            **shaking,
            **limits,
            **read_numbers(cls, entry, ("inertia",)),
            **(read_numbers(cls, friction, ("coulomb", "viscous")) if friction else {}),
        )

    @property
    def unit(self) -> str:
        """The unit of its commands."""
        return "N m" if self.command == "torque" else "rad/s"

    @property
    def is_balanced(self) -> bool:
        """Whether the wheel has no imbalance."""
        return self.static_imbalance == 0.0 == self.dynamic_imbalance

    def check(self, body: RigidBody) -> None:
        """Check that the wheel can be a part of `body`; see `require_contained`.

        Raises:
            SceneError: it cannot, or its friction is too strong for times in whole nanoseconds.
        """
        # A campaign checks each of its runs: mostly this is enough.
        least, fastest = min(body.principal_moments), max(self.viscous / _FASTEST_SLOWING, self.coulomb / FASTEST)
        if fastest * least < 0.5 * self.inertia * ((1.0 - 2.0 * _LEFT_OVER) * least - self.inertia):
            return
        require_contained([self], body)
        free = self._free_inertia(body)
        if self.viscous > _FASTEST_SLOWING * free or self.coulomb > FASTEST * free:
            raise SceneError(
                f"reaction_wheel: friction of {self.name} is {self.coulomb:g} N m (coulomb) and {self.viscous:g} N m "
                f"s/rad (viscous), expected at most {FASTEST * free:.3g} and {_FASTEST_SLOWING * free:.3g}: beyond, it "
                "would stop the wheel within nanoseconds, the unit of time; correct it, or leave out the wheel"
            )

    def axis_in(self, body: RigidBody) -> Vector:
        """Return the unit vector of the axis in principal axes."""
        axis = rotate_inverse(body.principal_orientation_xyzw, self.axis)
        return scale(1.0 / norm(axis), axis)

    def _free_inertia(self, body: RigidBody) -> float:
        """Return the inertia of the free wheel in a free body: W' is the torque between the two over it."""
        axis, moments = self.axis_in(body), body.principal_moments
        # J (W' + a . w') = u, and (I - J a a^T) w' = -u a.
        return self.inertia * (1.0 - self.inertia * dot(axis, divide(axis, moments)))

    def spin_up(self, value: float) -> float:
        """Return the angular acceleration (rad/s^2) that the motor gives the wheel at most under a command."""
        return (abs(value) if self.command == "torque" else self.max_torque) / self.inertia

    @property
    def most(self) -> float:
        """The largest command, after its limits, that can be simulated at all."""
        return FASTEST * self.inertia if self.command == "torque" else math.inf

    def _accept(self, value: float) -> Accepted:
        accepted = clipped(value, self.max_torque if self.command == "torque" else self.max_speed)
        if abs(accepted.value) > self.most:
            limit = "give" if self.max_torque == math.inf else "a smaller"
            raise WrenchError(
                f"{self.topic}: {value!r} N m, expected at most {self.most:.3g} N m: the wheel would soon turn by a "
                f"radian in a nanosecond, the unit of time; correct what commands it, or {limit} max_torque"
            )
        return accepted


def friction_rate(wheels: Sequence[ReactionWheel], body: RigidBody) -> tuple[float, str]:
    """Return the largest rate (1/s) at which viscous friction slows wheels that turn freely in a free body; in words.

    Wheels share the body: those that turn together may be slowed faster than each alone.
    """
    if not any(wheel.viscous for wheel in wheels):
        return 0.0, ""
    import numpy as np

    # J (W' + A w') = -v W, and I w' + A^T J W' = 0, with a row of A for each axis.
    inertia = np.array([wheel.inertia for wheel in wheels])
    momenta = inertia[:, None] * np.array([wheel.axis_in(body) for wheel in wheels])
    free = np.diag(inertia) - momenta / np.array(body.principal_moments) @ momenta.T
    slowing = np.linalg.solve(free, np.diag([wheel.viscous for wheel in wheels]))
    rates, parts = np.linalg.eig(slowing)
    fastest = rates.real.argmax()
    rate, share = float(rates.real[fastest]), abs(parts[:, fastest])
    names = [wheel.name for wheel, part in zip(wheels, share.tolist(), strict=True) if part > 0.1 * share.max()]
    found = " and ".join(names) + (" is slowed by its" if len(names) == 1 else " are slowed by their")
    return rate, f"{found} viscous friction within {1.0 / rate:.2g} s"


def require_contained(effects: Sequence[Effect], body: RigidBody) -> None:
    """Check that the reaction wheels among `effects`, with the rotors, can together be parts of `body`.

    Its inertia I without theirs, I - sum of J a a^T, must be positive definite.

    Raises:
        SceneError: the body is a particle, or they have more inertia than the body about some direction.
    """
    wheels = [each for each in effects if isinstance(each, ReactionWheel)]
    if not wheels:
        return
    if body.is_particle:
        raise SceneError("reaction_wheel: the body is a particle, expected one with inertia; add body.inertia")
    rotors = [each.spin(body, 0.0) for each in effects if isinstance(each, Rotor)]
    # As in `check`; with room for rounding.
    whole = math.fsum([*(wheel.inertia for wheel in wheels), *(rotor.inertia for rotor in rotors)])
    if whole < (1.0 - 2.0 * _LEFT_OVER) * min(body.principal_moments):
        return
    inner = [(wheel.axis_in(body), wheel.inertia) for wheel in wheels]
    inner += [(rotor.axis, rotor.inertia) for rotor in rotors]
    # In units in which I is the unit matrix, the largest eigenvalue of the sum is their largest part of it.
    scales = [math.sqrt(moment) for moment in body.principal_moments]
    rows = [[math.sqrt(j) * x / s for x, s in zip(axis, scales, strict=True)] for axis, j in inner]
    if math.fsum(x * x for row in rows for x in row) < 1.0 - _LEFT_OVER:
        return
    a, b, c = (tuple(math.fsum(row[i] * row[k] for row in rows) for k in range(3)) for i in range(3))
    parts, axes = diagonalize(((a[0], a[1], a[2]), (b[0], b[1], b[2]), (c[0], c[1], c[2])))
    part = max(parts)
    if part < 1.0 - _LEFT_OVER:
        return
    worst = [0.0, 0.0, 0.0]
    worst[parts.index(part)] = 1.0
    x, y, z = (u / s for u, s in zip(rotate(axes, (worst[0], worst[1], worst[2])), scales, strict=True))
    way = scale(1.0 / norm((x, y, z)), (x, y, z))
    whole = dot(way, times(body.principal_moments, way))
    x, y, z = rotate(body.principal_orientation_xyzw, way)
    found = " and ".join([*(wheel.name for wheel in wheels), *("a rotor" for _ in rotors)])
    raise SceneError(
        f"reaction_wheel: the inertia of {found} is {part * whole:.6g} kg m^2 about ({x:.3g}, {y:.3g}, {z:.3g}), "
        f"expected less than the {whole:.6g} kg m^2 of the body about it, by {_LEFT_OVER:g} of that at least, as they "
        "are contained in the body; add them to body.inertia, or correct inertia"
    )
