"""The messages of a log: the topics of a sample, their types, their QoS and their bytes.

Log, node and replay all use this encoder. Must not import ROS or touch a file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, cast

from rb_dynamics.formats import cdr
from rb_dynamics.formats import message_types as types
from rb_dynamics.formats.channel_metadata import qos_profile
from rb_dynamics.formats.mcap_records import Message
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, split_stamp
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import AppliedWrench, Latency, Measurement, StateChange, Status

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Times = npt.NDArray[np.int64]
    Bytes = npt.NDArray[np.uint8]

    from rb_dynamics.loads.wrench import WrenchFrames
    from rb_dynamics.scene.model import Scene
    from rb_dynamics.sensors.sensor import Sensor

SAMPLE_TOPICS = (
    ("pose", types.POSE),
    ("twist", types.TWIST),
    ("odom", types.ODOMETRY),
    ("angular_momentum", types.VECTOR),
    ("linear_momentum", types.VECTOR),
    ("energy/kinetic", types.SCALAR),
    ("energy/work", types.SCALAR),
    ("energy/defect", types.SCALAR),
    ("/tf", types.TRANSFORMS),
)

APPLIED = "/applied"
"""What the name of a channel is followed by in the name of the topic that has what acted."""

LATENCY = "/latency"
"""What the name of a channel is followed by in the name of the topic that says how long each command was on its way."""

POTENTIAL = ("energy/potential", types.SCALAR)
"""Where an effect has a potential energy."""

WHEELS = ("wheels", types.JOINTS)
WHEEL_TOPICS = (WHEELS, ("energy/motor_work", types.SCALAR), ("energy/friction_heat", types.SCALAR))
"""Where the scene has reaction wheels; older logs have only the first."""

ACCEL = ("accel", types.ACCELERATION)
"""Where it is asked for."""

MASS_PROPERTIES = ("inertia", types.INERTIA)
"""Once at the beginning of each file."""

SET_STATE = ("set_state", types.ODOMETRY)
"""In a log to which the body was moved from outside: to where, from its first such message on."""

TF_STATIC = ("/tf_static", types.TRANSFORMS)
"""Where the scene has frames fixed on the body."""

COMMAND_DEPTH = 1000
"""How many commands the node keeps until it reads them: what plays a log to a node must keep as many."""

Acceleration = Callable[[], tuple[Vector, Vector]]


def sample_depth(scene: Scene) -> int:
    """Return how many samples are kept for a reader that is busy: those of half a second, but 10 to 1000."""
    return depth_at(scene.output_rate or 1.0 / (scene.solver.step or 1.0))


def depth_at(rate: float) -> int:
    """Return the same for messages at a rate (Hz)."""
    return min(1000, max(10, round(rate / 2)))


def sample_topics(scene: Scene, accel: bool) -> tuple[tuple[str, str], ...]:
    """Return name and type of each topic that a sample of `scene` has, in order."""
    potential = () if scene.combined_effects.potential() is None else (POTENTIAL,)
    wheels = WHEEL_TOPICS if scene.wheels else ()
    return (*SAMPLE_TOPICS, *potential, *wheels, *((ACCEL,) if accel else ()))


def acting(scene: Scene) -> list[str]:
    """Return the names of all that holds a wrench, which a log has as `APPLIED`: channels, effects and thrusters."""
    return [
        *(channel.topic for channel in scene.channels),
        *(name for name, _ in scene.combined_effects.schedules()),
        *(each.name for each in scene.actuators if isinstance(each, Thruster)),
    ]


def log_topics(scene: Scene, accel: bool) -> list[tuple[str, str, str]]:
    """Return name, type and QoS of each topic of a log: of samples first, commands, what effects hold, and the rest."""
    usual, latched = qos_profile(sample_depth(scene)), qos_profile(1, "transient_local")
    command = qos_profile(COMMAND_DEPTH)
    return [
        *((name, type_name, usual) for name, type_name in sample_topics(scene, accel)),
        *((name, types.WRENCH, command) for each in scene.channels for name in (each.topic, each.topic + APPLIED)),
        *((name + APPLIED, types.WRENCH, command) for name, _ in scene.combined_effects.schedules()),
        *((each.topic, types.SCALAR, command) for each in scene.actuators),
        *((each.name + APPLIED, types.WRENCH, command) for each in scene.actuators if isinstance(each, Thruster)),
        *((sensor.name, sensor.message, qos_profile(depth_at(sensor.rate))) for sensor in scene.sensors),
        (*MASS_PROPERTIES, latched),
        *([(*TF_STATIC, latched)] if scene.frames.fixed else []),
        ("/diagnostics", types.DIAGNOSTICS, qos_profile(1)),
    ]


def decode_wrench(type_name: str, log_time: int, data: bytes) -> Wrench:
    """Return the command in a message; one without header has `log_time` (ns) as stamp and frame "".

    Raises:
        LogError: the message is cut short or not CDR.
    """
    values = cdr.decode(type_name, data)
    if type_name != types.WRENCH:
        (numbers,) = values
        return Wrench(numbers[:3], numbers[3:], "", log_time)
    stamp, frame, numbers = values
    wrench = Wrench(numbers[:3], numbers[3:], frame, stamp)
    object.__setattr__(wrench, "message", data)
    return wrench


def encode_applied(event: AppliedWrench) -> bytes:
    """Return the message of a wrench as it acts."""
    pack = cdr.stamped_packer(types.WRENCH, event.frame_id)
    return pack(*split_stamp(event.time_ns), *event.force, *event.torque)


def encode_wheels(scene: Scene, time_ns: int, speeds: Sequence[float]) -> bytes:
    """Return a JointState of the speeds (rad/s) of the scene's reaction wheels."""
    names = [(wheel.name,) for wheel in scene.wheels]
    return cdr.encode(types.JOINTS, time_ns, "", names, [], [((speed,),) for speed in speeds], [])


def encode_received(command: Wrench) -> bytes:
    """Return the message of a command, to the byte if it was received as one; its stamp may be of any clock."""
    if command.message is not None:
        return command.message
    pack = cdr.stamped_packer(types.WRENCH, command.frame_id)
    return pack(*split_stamp(command.stamp_ns), *command.force, *command.torque)


def measurement_packers(scene: Scene) -> dict[str, Callable[[Measurement, int], bytes]]:
    """Return the encoder of a measurement with a stamp (ns), by the name of the sensor."""

    def packer(sensor: Sensor) -> Callable[[Measurement, int], bytes]:
        pack = cdr.stamped_packer(sensor.message, sensor.frame_id(scene.frames))
        return lambda measurement, stamp_ns: pack(*split_stamp(stamp_ns), *measurement.numbers)

    return {sensor.name: packer(sensor) for sensor in scene.sensors}


def encode_latency(latency: Latency) -> bytes:
    """Return the message of a latency, stamped when it was sent: s to receiving, s from there to acting, number."""
    pack = cdr.stamped_packer(types.VECTOR, "")
    transport, waiting = latency.received_ns - latency.sent_ns, latency.acted_ns - latency.received_ns
    return pack(*split_stamp(latency.sent_ns), transport / NANOSECONDS, waiting / NANOSECONDS, float(latency.number))


def encode_state_change(change: StateChange, frames: WrenchFrames) -> bytes:
    """Return the message of a state that the body was moved to."""
    pack = cdr.odometry_packer(frames.world_frame, frames.body_frame)
    pose = *change.position_world, *change.orientation_xyzw
    return pack(*split_stamp(change.time_ns), pose, (*change.linear_velocity_body, *change.angular_velocity_body))


def is_state_change(topic: str, type_name: str) -> bool:
    """Return whether a topic is `SET_STATE`, in any namespace."""
    return (topic.rpartition("/")[2], type_name) == SET_STATE


def decode_state_change(message: Message) -> StateChange:
    """Return the state in a message of `SET_STATE`, at its log time, to the bit.

    Raises:
        LogError: the message is cut short or not CDR.
    """
    n = cdr.numbers(cdr.LAYOUTS[types.ODOMETRY], cdr.decode(types.ODOMETRY, message.data))
    p, q, v, w = (tuple(n[i:j]) for i, j in ((0, 3), (3, 7), (43, 46), (46, 49)))
    return StateChange(message.log_time, *cast("tuple[Vector, Quaternion, Vector, Vector]", (p, q, v, w)))


def encode_setpoint(value: float) -> bytes:
    """Return the message of a command to an actuator."""
    return cdr.encode(types.SCALAR, (value,))


def decode_setpoint(data: bytes) -> float:
    """Return the command to an actuator in a message.

    Raises:
        LogError: the message is cut short or not CDR.
    """
    ((value,),) = cdr.decode(types.SCALAR, data)
    return float(value)


def encode_inertia(scene: Scene, time_ns: int) -> bytes:
    """Return the message with the mass properties of the body."""
    body = scene.body
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia
    values = (body.mass, *body.center_of_mass, xx, xy, xz, yy, yz, zz)
    return cdr.encode(types.INERTIA, time_ns, scene.frames.body_frame, values)


def encode_status(status: Status, hardware_id: str) -> bytes:
    """Return the message of a status on `/diagnostics`."""
    values = (status.level, status.name, status.message, hardware_id, list(status.values.items()))
    return cdr.encode(types.DIAGNOSTICS, status.time_ns, "", [values])


def encode_fixed(frames: WrenchFrames, time_ns: int) -> bytes:
    """Return the message with the poses of the fixed frames on the body."""
    parts = [
        (time_ns, frames.body_frame, name, (*frame.position, *frame.orientation_xyzw))
        for name, frame in (frames.fixed or {}).items()
    ]
    return cdr.encode(types.TRANSFORMS, parts)


class Stamped:
    """A sample as its messages have it: the stamp in two integers, the pose, and the twist in body axes.

    Attributes:
        sample: with the rest.
        stamp: seconds and nanoseconds.
        pose: position of the body origin (m, world axes) and attitude xyzw.
        twist: velocity of the body origin (m/s) and angular velocity (rad/s), body axes.
    """

    __slots__ = ("pose", "sample", "stamp", "twist")

    def __init__(self, sample: Sample, stamp_ns: int) -> None:
        """Stamp `sample` with `stamp_ns`.

        Raises:
            LogError: a stamp does not hold that time.
        """
        self.sample, self.stamp = sample, split_stamp(stamp_ns)
        self.pose = (*sample.position_world, *sample.orientation_xyzw)
        velocity_body = rotate_inverse(sample.orientation_xyzw, sample.linear_velocity_world)
        self.twist = (*velocity_body, *sample.angular_velocity_body)


def sample_packers(scene: Scene, acceleration: Acceleration | None = None) -> dict[str, Callable[[Stamped], bytes]]:
    """Return the encoder of each of `sample_topics`, in their order, by the name of the topic.

    `acceleration` gives that of the body origin (m/s^2) and the angular one (rad/s^2) at the sample, body axes; None
    leaves the topic out.
    """
    world, body = scene.frames.world_frame, scene.frames.body_frame
    pack_pose, pack_twist = cdr.stamped_packer(types.POSE, world), cdr.stamped_packer(types.TWIST, body)
    pack_odometry, pack_vector = cdr.odometry_packer(world, body), cdr.stamped_packer(types.VECTOR, world)
    pack_transform, pack_scalar = cdr.transform_packer(world, body), cdr.float64_packer()
    packers: dict[str, Callable[[Stamped], bytes]] = {
        "pose": lambda s: pack_pose(*s.stamp, *s.pose),
        "twist": lambda s: pack_twist(*s.stamp, *s.twist),
        "odom": lambda s: pack_odometry(*s.stamp, s.pose, s.twist),
        "angular_momentum": lambda s: pack_vector(*s.stamp, *s.sample.angular_momentum_world),
        "linear_momentum": lambda s: pack_vector(*s.stamp, *s.sample.linear_momentum_world),
        "energy/kinetic": lambda s: pack_scalar(s.sample.kinetic_energy),
        "energy/work": lambda s: pack_scalar(s.sample.work),
        "energy/defect": lambda s: pack_scalar(s.sample.energy_defect),
        "/tf": lambda s: pack_transform(*s.stamp, s.pose),
        POTENTIAL[0]: lambda s: pack_scalar(s.sample.potential_energy),
    }
    if scene.wheels:

        def pack_wheels(s: Stamped) -> bytes:
            return encode_wheels(scene, s.stamp[0] * NANOSECONDS + s.stamp[1], s.sample.wheel_speeds or ())

        energies: tuple[Callable[[Stamped], bytes], ...] = (
            lambda s: pack_scalar(s.sample.motor_work),
            lambda s: pack_scalar(s.sample.friction_heat),
        )
        packers |= zip((name for name, _ in WHEEL_TOPICS), (pack_wheels, *energies), strict=True)
    if acceleration is not None:
        pack_accel = cdr.stamped_packer(types.ACCELERATION, body)
        packers[ACCEL[0]] = lambda s: pack_accel(*s.stamp, *chain(*acceleration()))
    return {name: packers[name] for name, _ in sample_topics(scene, acceleration is not None)}


def block_encoder(scene: Scene) -> tuple[tuple[bytes, ...], Callable[[list[Bytes], Sample, Times], None]]:
    """Return the messages of a body at rest, and what makes many copies of each the messages of as many samples.

    `fill(messages, samples, times_ns)` takes (n, length) for each topic, and samples that are one with arrays. The
    topics are `sample_topics` without the acceleration, the bytes those of `sample_encoder`.
    """
    import numpy as np

    topics = sample_topics(scene, accel=False)
    wheels = (0.0,) * len(scene.wheels)
    still = Sample(0, ZERO, IDENTITY, ZERO, ZERO, ZERO, ZERO, 0.0, 0.0, 0.0, ZERO, ZERO, 0.0, wheels, 0.0, 0.0)
    models = sample_encoder(scene)(still)

    def fill(messages: list[Bytes], samples: Sample, times_ns: Times) -> None:
        pose = (*samples.position_world, *samples.orientation_xyzw)
        velocity_body = rotate_inverse(samples.orientation_xyzw, samples.linear_velocity_world)
        twist = (*velocity_body, *samples.angular_velocity_body)
        # By the places of the runs of float64; covariances stay as they are.
        numbers: dict[str, tuple[Any, ...]] = {
            "pose": (pose,),
            "twist": (twist,),
            "odom": (pose, None, twist, None),
            "angular_momentum": (samples.angular_momentum_world,),
            "linear_momentum": (samples.linear_momentum_world,),
            "energy/kinetic": ((samples.kinetic_energy,),),
            "energy/work": ((samples.work,),),
            "energy/defect": ((samples.energy_defect,),),
            "/tf": (pose,),
            POTENTIAL[0]: ((samples.potential_energy,),),
        }
        for (name, kind), model, rows in zip(topics, models, messages, strict=True):
            cdr.fill(rows, kind, model, times_ns, [run and np.stack(run, axis=1) for run in numbers[name]])

    return models, fill


def sample_encoder(scene: Scene, acceleration: Acceleration | None = None) -> Callable[[Sample], tuple[bytes, ...]]:
    """Return what makes the messages of a sample of `scene`, in the order of `sample_topics`."""
    packers = list(sample_packers(scene, acceleration).values())

    def encode(sample: Sample) -> tuple[bytes, ...]:
        stamped = Stamped(sample, sample.time_ns)
        return tuple([pack(stamped) for pack in packers])

    return encode
