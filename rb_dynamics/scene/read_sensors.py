"""Read the `sensors` section of a scene. Each type reads its own values."""

from __future__ import annotations

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.formats.yaml.fields import Field
from rb_dynamics.loads.scene_entry import SceneEntry
from rb_dynamics.loads.wrench import WrenchFrames
from rb_dynamics.scene.read_channels import topic_in
from rb_dynamics.scene.read_effects import each_entry, require_field
from rb_dynamics.sensors.sensor import COMMON_KEYS, Sensor
from rb_dynamics.sensors.sensor_types import SENSORS


def sensors(
    field: Field | None, body: RigidBody | None, frames: WrenchFrames, magnetic: bool, taken: dict[str, str]
) -> tuple[Sensor, ...]:
    """Return the sensors in the order of the scene, empty if the section is absent; records problems.

    Args:
        field: the section.
        body: None if the scene has no valid one.
        frames: where a sensor may be.
        magnetic: whether the scene has a magnetic field.
        taken: the topics of the scene, each with its key; those of the sensors come into it.
    """

    def read(kind: type[Sensor], entry: Field) -> Sensor:
        values = entry.section(("type", *COMMON_KEYS, *kind.keys))
        topic_in(values, "name", kind.kind, taken)
        require_field(entry, kind.needs_field, magnetic)
        return kind.read(SceneEntry(values, body, frames))

    return each_entry(field, SENSORS, "a sensor", "{type: imu, name: imu, rate: 100}", "that can be built", read)
