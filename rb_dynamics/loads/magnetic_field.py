"""A magnetic field, uniform, of a dipole or the Earth's, for magnetometers and magnetorquers: no force of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from rb_dynamics.errors import ConvergenceError, SceneError
from rb_dynamics.loads.effect import Effect, Field
from rb_dynamics.loads.igrf import EPOCH, field_in_world, terms_at
from rb_dynamics.loads.number_ranges import check_vector
from rb_dynamics.numerics.argument_checks import instance, shown
from rb_dynamics.numerics.compilation import compiled_as
from rb_dynamics.numerics.vector import ZERO, Vector, add_scaled, dot, norm, scale, subtract

if TYPE_CHECKING:
    from rb_dynamics.loads.scene_entry import SceneEntry

MODELS = ("uniform", "dipole", "igrf")

_KEYS = {
    "uniform": ("field_world",),
    "dipole": ("moment_world", "center_world"),
    "igrf": ("center_world", "epoch"),
}

# mu_0 / 4 pi (T m/A): its value before 2019, which CODATA 2018 confirms to 2e-10.
_MU_0_BY_4_PI = 1e-7


class Source(NamedTuple):
    """A uniform flux density (T), or a dipole moment (A m^2) and its place (m); world axes."""

    is_dipole: bool
    field: Vector
    moment: Vector
    center: Vector


def flux_density(source: Source, place: Vector) -> Vector:
    """Return B (T) at a place.

    Raises:
        ConvergenceError: the place is where the dipole is.
    """
    if not source.is_dipole:
        return source.field
    away, moment = subtract(place, source.center), source.moment
    distance = norm(away)
    if distance == 0.0:
        return _infinite(place)
    n = scale(1.0 / distance, away)
    strength = _MU_0_BY_4_PI / distance / distance / distance
    return scale(strength, add_scaled(scale(-1.0, moment), 3.0 * dot(n, moment), n))


@compiled_as((math.nan, math.nan, math.nan))
def _infinite(place: Vector) -> Vector:
    raise ConvergenceError(
        f"magnetic_field: the dipole is at {list(place)}, where its field is infinite; move center_world or the body"
    )


@dataclass(frozen=True)
class MagneticField(Effect):
    """A magnetic flux density B (T); uniform and dipole are constant in world axes.

    A dipole m (A m^2) at c has B = mu_0 / (4 pi) (3 n (n . m) - m) / r^3, with r n from c to the place (Wertz,
    Spacecraft Attitude Determination and Control, eq. H-16). m may be tilted, but is
    fixed in world axes: it does not turn with the Earth. `igrf` is the International Geomagnetic Reference Field of the
    package ppigrf, with the coefficients of `epoch`; it turns with the Earth about z, see `igrf.py`.

    Attributes:
        model: `uniform`, `dipole` or `igrf`.
        field_world: flux density of the uniform field, T.
        moment_world: moment of the dipole, A m^2; the Earth's, about -7.8e22 along its axis, points south.
        center_world: place of the dipole or of the centre of the Earth, m.
        epoch: UTC of time 0, ISO 8601, for `igrf`.
    """

    kind: ClassVar[str] = "magnetic_field"
    keys: ClassVar[tuple[str, ...]] = ("model", "field_world", "moment_world", "center_world", "epoch")

    model: str = "uniform"
    field_world: Vector = ZERO
    moment_world: Vector = ZERO
    center_world: Vector = ZERO
    epoch: str = ""

    @classmethod
    def read(cls, entry: SceneEntry) -> MagneticField:
        """Return the effect of an entry."""
        model = entry.text("model", f"one of {', '.join(MODELS)}", "")
        if model not in MODELS:
            expected = f"one of {', '.join(MODELS)}"
            if entry.has("model"):
                entry.reject(expected, "write one of them", "model")
            else:
                entry.section.missing("model", expected, "add model: uniform, model: dipole or model: igrf")
            return cls()
        for key in (key for key in cls.keys[1:] if key not in _KEYS[model]):
            entry.reject(f"no {key}, as the model is {model}", "remove it, or write another model", key)
        if model == "igrf":
            center = entry.vector("center_world", "a finite number (m)", ZERO)
            if not entry.has("epoch"):
                entry.section.missing("epoch", EPOCH, "add epoch: 2025-06-01T12:00:00Z")
                return cls()
            return cls(model, center_world=center, epoch=entry.text("epoch", EPOCH, ""))
        if model == "uniform":
            return cls(model, field_world=entry.vector("field_world", "a finite number (T)"))
        moment = entry.vector("moment_world", "a finite number (A m^2)")
        return cls(model, ZERO, moment, entry.vector("center_world", "a finite number (m)", ZERO))

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            TypeError: an argument is not of its type.
            SceneError: there is no such model, or a number is not finite.
        """
        if self.model not in MODELS:
            raise SceneError(
                f"magnetic_field: model is {shown(self.model)}, expected {' or '.join(MODELS)}; write one of them"
            )
        if self.model == "igrf":
            terms_at(instance(self.epoch, str, "magnetic_field: epoch", "write a text"))
        check_vector(self, "field_world", "a flux density (T)")
        check_vector(self, "moment_world", "a dipole moment (A m^2)")
        check_vector(self, "center_world", "a point (m)")

    def magnetic_field_at(self, time: float) -> Field:
        """Return B (T) at a time (s of the run) and a place."""
        if self.model != "igrf":
            return self.magnetic_field()
        return lambda place: field_in_world(self.epoch, time, self.center_world, place)

    def magnetic_field(self) -> Field:
        """Return B (T) at a place at time 0.

        Raises:
            ConvergenceError: the place is where the dipole is, or in the core of the Earth.
        """
        if self.model == "igrf":
            return self.magnetic_field_at(0.0)
        source = self.source
        return lambda place: flux_density(source, place)

    @property
    def source(self) -> Source:
        """The source of a uniform or dipole field; None for `igrf`, which has terms instead."""
        return Source(self.model == "dipole", self.field_world, self.moment_world, self.center_world)
