"""All effects that a scene can list, by their `type`. A new one is a file with one `Effect` and an entry here."""

from __future__ import annotations

from rb_dynamics.loads.buoyancy import Buoyancy
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.loads.magnetic_field import MagneticField
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.plugins import Registry

_ALL: tuple[type[Effect], ...] = (
    UniformGravity,
    CentralGravity,
    Buoyancy,
    LinearDrag,
    QuadraticDrag,
    Rotor,
    ScheduledWrench,
    MagneticField,
)


def _fault(name: str, found: object) -> str:
    if not (isinstance(found, type) and issubclass(found, Effect)):
        return f"{found!r}, expected a subclass of rb_dynamics.Effect"
    kind = getattr(found, "kind", None)
    return "" if kind == name else f"of kind {kind!r}, expected {name!r}, the name of its entry point"


EFFECTS: Registry[type[Effect]] = Registry("effect", {effect.kind: effect for effect in _ALL}, _fault)
