"""Read the `actuators` and `sensors` sections of a scene. Each type reads its own values."""

from __future__ import annotations

from collections.abc import Sequence

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.formats.message_types import COMMAND
from rb_dynamics.formats.yaml.fields import Field, Section
from rb_dynamics.loads.actuator import Actuator
from rb_dynamics.loads.actuator_types import ACTUATORS
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.reaction_wheel import require_contained
from rb_dynamics.loads.scene_entry import SceneEntry
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.scene.read_effects import each_entry
from rb_dynamics.scene.read_wrench_channels import topic_in
from rb_dynamics.sensors.sensor import COMMON_KEYS, Sensor


def devices(
    root: Section, body: RigidBody | None, frames: WrenchFrames, acting: Sequence[Effect], taken: dict[str, str]
) -> tuple[tuple[Actuator, ...], tuple[Sensor, ...]]:
    """Return the actuators and the sensors in the order of the scene, empty without their section; records problems.

    Args:
        root: the scene.
        body: None if the scene has no valid one.
        frames: where a device may be.
        acting: the effects of the scene.
        taken: the topics of the scene, each with its key; those of the devices are added.
    """
    magnetic = any(effect.magnetic_field() is not None for effect in acting)

    def values(kind: type[Actuator | Sensor], entry: Field, *common: str) -> SceneEntry:
        section = entry.section(("type", *common, *kind.keys))
        # The name of an actuator itself is reserved too: the force of a thruster is on `<name>/applied`.
        if topic_in(section, "name", kind.kind, taken) and issubclass(kind, Actuator):
            topic_in(section, "name", kind.kind, taken, COMMAND)
        if kind.needs_field and not magnetic:
            entry.reject("a scene with a magnetic field", "add {type: magnetic_field, ...} to effects")
        return SceneEntry(section, body, frames)

    def actuator(kind: type[Actuator], entry: Field) -> Effect:
        before = entry.problems.count
        found = kind.read(values(kind, entry))
        if entry.problems.count == before and body is not None:
            found.check(body)
        return found

    def sensor(kind: type[Sensor], entry: Field) -> Sensor:
        return kind.read(values(kind, entry, *COMMON_KEYS))

    unfit, jet, imu = "that can be built", "{type: thruster, name: jet_1, ...}", "{type: imu, name: imu, rate: 100}"
    listed, before = root.get("actuators"), root.field.problems.count
    found = each_entry(listed, ACTUATORS, "an actuator", jet, unfit, actuator)
    if listed is not None and body is not None and root.field.problems.count == before:
        try:
            require_contained((*acting, *found), body)
        except SceneError as error:
            listed.reject("wheels that fit into the body together", str(error))
    actuators = tuple(each for each in found if isinstance(each, Actuator))
    if (listed := root.get("sensors")) is None:
        return actuators, ()

    from rb_dynamics.sensors.sensor_types import SENSORS

    return actuators, each_entry(listed, SENSORS, "a sensor", imu, unfit, sensor)
