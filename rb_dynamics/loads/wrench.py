"""Wrench commands, and the one rule that says in which axes and through which point they act.

Where a command comes from (topic, bag or script) and when it takes effect is decided in `wrench_channels.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from operator import attrgetter
from typing import Any, NamedTuple

from rb_dynamics.body.moments_of_force_and_momentum import moment_of_force
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError, WrenchError
from rb_dynamics.numerics.argument_checks import instance, mapping, quaternion, shown, vector
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, rotate
from rb_dynamics.numerics.vector import ZERO, Vector, add, scale

WORLD = "<world>"
"""`frame_id` for world axes in wrenches of effects, whatever their name in the scene; no frame has this name."""


@dataclass(frozen=True, slots=True)
class Wrench:
    """A force and a torque as commanded: `geometry_msgs/WrenchStamped` without ROS.

    Attributes:
        force: N, in the axes of `frame_id`.
        torque: N m, in the axes of `frame_id`.
        frame_id: "" or the body frame, the world frame, or a fixed frame that the scene declares; a leading slash is
            taken off.
        stamp_ns: `header.stamp` of the command, integer nanoseconds.
        message: the bytes of the WrenchStamped as received; None if there was none, and in a changed copy. Not compared
            by `==`.
    """

    force: Vector = ZERO
    torque: Vector = ZERO
    frame_id: str = ""
    stamp_ns: int = 0
    message: bytes | None = field(default=None, init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Copy the arguments; invalid numbers are rejected only when the command would take effect.

        Whole numbers become floats, infinite beyond the range of double precision.

        Raises:
            TypeError: force or torque does not have three components, or frame_id is not text, so that it could not be
                logged.
        """
        instance(self.frame_id, str, "wrench frame_id", "write the name of a frame")
        if self.frame_id.startswith("/"):
            object.__setattr__(self, "frame_id", frame_name(self.frame_id))
        for name in ("force", "torque"):
            given: object = getattr(self, name)
            if type(given) is not tuple:
                given = given.tolist() if hasattr(given, "tolist") else given
                given = tuple(given) if isinstance(given, (list, Iterator)) else given
                object.__setattr__(self, name, given)
            if type(given) is not tuple or len(given) != 3:
                raise TypeError(f"wrench {name} is {shown(given)}, expected three components; write (x, y, z)")
            if not type(given[0]) is type(given[1]) is type(given[2]) is float:
                object.__setattr__(self, name, tuple(map(_within_doubles, given)))


def frame_name(frame_id: str) -> str:
    """Return the name of the frame in a message: leading slashes, a habit of ROS 1, mean nothing, as in tf2."""
    return frame_id.lstrip("/")


def _within_doubles(component: Any) -> Any:
    """Return a component: a float or a whole number as a float, infinite if too large; anything else as it is."""
    try:
        number = float(component)
    except OverflowError:
        return -math.inf if component < 0 else math.inf
    except (TypeError, ValueError):
        return component
    # A truth value is no number; that is judged when the command would take effect.
    return number if isinstance(component, (float, int)) and not isinstance(component, bool) else component


@dataclass(frozen=True, slots=True)
class FixedFrame:
    """A frame fixed to the body: position of its origin from the body origin (m) and its axes, both in body axes."""

    position: Vector = ZERO
    orientation_xyzw: Quaternion = IDENTITY

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            ValueError: a number is not finite, or the norm of the quaternion not 1 within `NORM_TOLERANCE`.
        """
        object.__setattr__(self, "position", vector(self.position, "position", "a point (m)"))
        object.__setattr__(self, "orientation_xyzw", quaternion(self.orientation_xyzw, "orientation_xyzw"))


class HeldWrench(NamedTuple):
    """A held command in terms of the body: force through and torque about the centre of mass.

    `*_body` parts turn with the body inside a step, `*_world` parts do not. N and N m.
    """

    force_body: Vector = ZERO
    torque_body: Vector = ZERO
    force_world: Vector = ZERO
    torque_world: Vector = ZERO

    # Without this, + would silently concatenate two wrenches to a tuple of eight vectors.
    def __add__(self, other: HeldWrench) -> HeldWrench:  # type: ignore[override]
        """Return the sum of two wrenches."""
        return HeldWrench(
            add(self.force_body, other.force_body),
            add(self.torque_body, other.torque_body),
            add(self.force_world, other.force_world),
            add(self.torque_world, other.torque_world),
        )


def combined(a: float, one: HeldWrench, b: float, other: HeldWrench) -> HeldWrench:
    """Return a times one wrench plus b times another."""
    return HeldWrench(
        add(scale(a, one.force_body), scale(b, other.force_body)),
        add(scale(a, one.torque_body), scale(b, other.torque_body)),
        add(scale(a, one.force_world), scale(b, other.force_world)),
        add(scale(a, one.torque_world), scale(b, other.torque_world)),
    )


def held_of(numbers: Sequence[float]) -> HeldWrench:
    """Return the held wrench with these twelve numbers."""
    n = numbers
    return HeldWrench((n[0], n[1], n[2]), (n[3], n[4], n[5]), (n[6], n[7], n[8]), (n[9], n[10], n[11]))


@dataclass(frozen=True)
class WrenchFrames:
    """The frames a wrench may be given in, and the wrench rule.

    Attributes:
        world_frame: name of the inertial frame.
        body_frame: name of the body frame.
        fixed: further frames fixed to the body, by name.
        center_of_mass: in body axes from the body origin, m. None for that of the scene's body; without a scene, the
            body origin.
        turns: whether a torque can act, as it cannot on a particle. None: as the scene's body.
    """

    world_frame: str = "world"
    body_frame: str = "body"
    fixed: Mapping[str, FixedFrame] | None = None
    center_of_mass: Vector | None = None
    turns: bool | None = None
    # Another body replaces values that came from the body of a scene, but not those from a user.
    _of_body: bool = field(default=False, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: a field is not of its type.
            ValueError: a coordinate is not finite.
            SceneError: a frame has no name, or the name of another frame.
        """
        for name in ("world_frame", "body_frame"):
            instance(getattr(self, name), str, name, "write the name of a frame")
        if self.fixed is not None:
            # A copy, because the user's mapping may change.
            fixed = dict(mapping(self.fixed, "fixed", "write {'thruster': FixedFrame(...)}"))
            for name, frame in fixed.items():
                instance(name, str, "fixed", "write the name of a frame")
                instance(frame, FixedFrame, f"fixed[{name!r}]", "write FixedFrame(position, orientation_xyzw)")
            object.__setattr__(self, "fixed", fixed)
        # A command names its frame: of two frames with the same name, it would act in the first.
        names = [self.world_frame, self.body_frame, *(self.fixed or {})]
        if len({"", WORLD, *names}) < len(names) + 2 or any(name.startswith("/") for name in names):
            raise SceneError(
                f"frames are named {names}, expected names that differ, none of them empty, {WORLD!r} or with a "
                "leading slash: world, body and fixed frames are told apart by them alone; rename one"
            )
        if self.center_of_mass is not None:
            object.__setattr__(self, "center_of_mass", vector(self.center_of_mass, "center_of_mass", "a point (m)"))
        if self.turns is not None:
            instance(self.turns, bool, "turns", "write True, or False for a particle")

    def of(self, body: RigidBody) -> WrenchFrames:
        """Return these frames with the centre of mass of `body`, and whether it turns.

        Raises:
            SceneError: they were made with values that contradict it.
        """
        center, turns = body.center_of_mass, not body.is_particle
        if self._of_body and (self.center_of_mass, self.turns) == (center, turns):
            return self
        for name, said in (("center_of_mass", center), ("turns", turns)):
            if not self._of_body and getattr(self, name) not in (None, said):
                raise SceneError(
                    f"frames.{name} is {shown(getattr(self, name))}, expected {shown(said)} as the body has it; leave "
                    "it out: frames take it from the body of their scene"
                )
        frames = replace(self, center_of_mass=center, turns=turns)
        object.__setattr__(frames, "_of_body", True)
        return frames

    @property
    def names(self) -> list[str]:
        """Every `frame_id` that a wrench may have."""
        return ["", self.body_frame, self.world_frame, *(self.fixed or {})]

    def hold(self, wrench: Wrench) -> HeldWrench:
        """Return `wrench` about the centre of mass: tau_com = R tau + (p - c) x (R f) for a fixed frame.

        Body and world wrenches act through the centre of mass. Moment of a force about a point: lecture 24, page 9.

        Raises:
            TypeError: force or torque is not three numbers.
            WrenchError: a component is not finite, `frame_id` is not a known frame, or a torque acts on a particle.
        """
        held = self._hold(wrench)
        if self.turns is False and (held.torque_body, held.torque_world) != (ZERO, ZERO):
            torque = [b or w for b, w in zip(held.torque_body, held.torque_world, strict=True)]
            raise WrenchError(
                f"wrench torque about the centre of mass is {torque}, expected none: the body has no inertia, it is a "
                "particle; add body.inertia to the scene or command a force alone"
            )
        return held

    def _hold(self, wrench: Wrench) -> HeldWrench:
        wrench = with_floats(wrench)
        return self.about_center_of_mass(wrench.force, wrench.torque, wrench.frame_id)

    def about_center_of_mass(self, force: Vector, torque: Vector, frame_id: str) -> HeldWrench:
        """Return force and torque in the axes of a frame as a held wrench, unchecked; components may be arrays.

        Raises:
            WrenchError: there is no such frame.
        """
        if frame_id in ("", self.body_frame):
            return HeldWrench(force_body=force, torque_body=torque)
        if frame_id == self.world_frame:
            return HeldWrench(force_world=force, torque_world=torque)
        frame = (self.fixed or {}).get(frame_id)
        if frame is None:
            raise WrenchError(
                f"wrench frame_id is {shown(frame_id)}, expected one of {self.names}; "
                "declare the frame under body.frames in the scene, name the body or the world like it (body.frame, "
                "world_frame), or transform the wrench before sending it"
            )
        return about_point(force, torque, frame.position, frame.orientation_xyzw, self.center_of_mass or ZERO)


def about_point(force: Vector, torque: Vector, position: Vector, axes: Quaternion, center: Vector) -> HeldWrench:
    """Return force and torque in `axes` at a position as a held wrench about `center`; components may be arrays.

    Position, axes and center are in body axes.
    """
    force, torque = rotate(axes, force), rotate(axes, torque)
    return HeldWrench(force_body=force, torque_body=add(torque, moment_of_force(force, position, center)))


# s; and the largest number whose square is a finite double.
_HELD, _SQUARE = 3600.0, 1e154
# rad/s^2: leads within a millisecond from rest to a radian per nanosecond.
FASTEST = 1e12


def largest_wrench(body: RigidBody) -> tuple[float, float]:
    """Return the largest force (N) and torque (N m) that can be simulated at all.

    Under this force, v^2 and m v^2 of a body that starts at rest stay within the range of doubles for an hour. Under
    this torque, it turns after a millisecond by at most a radian per nanosecond, the unit of time.
    """
    force = min(body.mass, math.sqrt(body.mass)) * (_SQUARE / _HELD)
    return force, math.inf if body.is_particle else FASTEST * min(body.principal_moments)


def require_possible(force: float, torque: float, largest: tuple[float, float]) -> None:
    """Check the largest components of a wrench about the centre of mass against those of `largest_wrench`.

    Raises:
        WrenchError: one is too large, or not a number.
    """
    for name, size, limit, unit, why in (
        ("force", force, largest[0], "N", "the body would leave the range of double precision within an hour"),
        ("torque", torque, largest[1], "N m", "the body would soon turn by a radian in a nanosecond, the unit of time"),
    ):
        # A moment may be infinity minus infinity.
        if not size <= limit:
            raise WrenchError(
                f"wrench {name} about the centre of mass is {size:.3g} {unit}, expected at most {limit:.3g} {unit}: "
                f"{why}; correct what commands it"
            )


def with_floats(wrench: Wrench) -> Wrench:
    """Return `wrench` with force and torque of plain floats.

    Raises:
        TypeError: one of them is not three numbers.
        WrenchError: a component is not finite.
    """
    instance(wrench, Wrench, "wrench", "write Wrench(force, torque)")
    force, torque = wrench.force, wrench.torque
    if type(force) is tuple is type(torque) and len(force) == 3 == len(torque):
        (a, b, c), (d, e, f) = force, torque
        # Fast, because a run may have a million commands, most of them valid: the difference of infinities is NaN.
        if float is type(a) is type(b) is type(c) is type(d) is type(e) is type(f) and (
            a - a + b - b + c - c + d - d + e - e + f - f == 0.0
        ):
            return wrench
    return replace(
        wrench,
        force=vector(force, "wrench force", "three components (N)", WrenchError),
        torque=vector(torque, "wrench torque", "three components (N m)", WrenchError),
    )


def all_with_floats(wrenches: Sequence[Wrench]) -> Sequence[Wrench]:
    """Return `wrenches` as `with_floats` does, but those with a component that is not finite unchanged.

    Raises:
        TypeError: a force or a torque is not three numbers.
    """
    # Fast, because a run may have a million commands, most of them of plain floats.
    if {*map(type, components(wrenches))} == {float}:
        return wrenches
    return [*map(_with_floats_if_finite, wrenches)]


def components(wrenches: Iterable[Wrench]) -> Iterator[float]:
    """Yield the components of force and torque of each wrench."""
    return chain.from_iterable(chain.from_iterable(map(attrgetter("force", "torque"), wrenches)))


def _with_floats_if_finite(wrench: Wrench) -> Wrench:
    try:
        return with_floats(wrench)
    except WrenchError:
        return wrench
