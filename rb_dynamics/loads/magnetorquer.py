"""A magnetorquer: a coil or rod whose magnetic dipole turns the body in the scene's magnetic field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rb_dynamics.loads.actuator import Accepted, Actuator, clipped
from rb_dynamics.loads.effect import Point
from rb_dynamics.loads.number_ranges import Range, check_vector, read_numbers
from rb_dynamics.loads.varying_load import LoadDependence
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, cross, norm, scale

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry


def turned_in_field(dipole: Vector, field: Vector, point: Point) -> tuple[Vector, Vector]:
    """Return force and torque on a dipole (A m^2, principal axes) in a field (T, world axes)."""
    return ZERO, cross(dipole, rotate_inverse(point.orientation, field))


@dataclass(frozen=True, kw_only=True)
class Magnetorquer(Actuator):
    """A dipole m along its axis, with the torque m x B in the field B at the centre of mass.

    A command is a dipole (A m^2), which acts at once and is held until the next one. There is no force: the field
    hardly changes over the body.

    Attributes:
        axis: body axes; its length does not matter.
        max_dipole: largest dipole in both directions, A m^2; a larger command is clipped.
    """

    kind: ClassVar[str] = "magnetorquer"
    takes: ClassVar[LoadDependence] = LoadDependence.FIELD
    keys: ClassVar[tuple[str, ...]] = ("name", "axis", "max_dipole")
    ranges: ClassVar[Mapping[str, Range]] = {
        "max_dipole": Range("a number greater than 0 (A m^2)", "write its largest dipole", above=0.0)
    }
    needs_field: ClassVar[bool] = True

    axis: Vector
    max_dipole: float

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: a number is out of range, or the axis is zero.
        """
        super().__post_init__()
        check_vector(self, "axis", "the direction of its axis", direction=True)

    @classmethod
    def read(cls, entry: SceneEntry) -> Magnetorquer:
        """Return the actuator of an entry."""
        return cls(
            name=entry.name or "magnetorquer",
            axis=entry.direction("axis", "write its axis in the body, such as [0, 0, 1]"),
            **read_numbers(cls, entry),
        )

    @property
    def unit(self) -> str:
        """The unit of its commands."""
        return "A m^2"

    def dipole(self, value: float) -> Vector:
        """Return the dipole (A m^2, body axes) of a command."""
        return scale(value / norm(self.axis), self.axis)

    def _accept(self, value: float) -> Accepted:
        return clipped(value, self.max_dipole)
