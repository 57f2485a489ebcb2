"""`McapSink`: a run as one MCAP file that ROS 2, Foxglove, PlotJuggler and Rerun open unchanged.

Profile `ros2`, CDR, one channel for each topic of the node with the node's QoS, and for each wrench channel what was
received (`<topic>`), honoured or not, and what acted (`<topic>/applied`). Times are simulation nanoseconds: those at
which a command took effect, whatever clock its stamp is of. The scene is attached as `scene.yaml`; metadata
`rb_dynamics` says what was run, `rb_dynamics.result` how it ended, with `states_sha256` over all samples.

Never imports ROS, never changes or drops a value, and holds back at most one chunk from the file.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, cast

from rb_dynamics.diagnostics import Sample
from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.recording import cdr
from rb_dynamics.recording.provenance import version
from rb_dynamics.recording.ros2msg import TYPE_HASHES, schema_text
from rb_dynamics.recording.sink import AppliedWrench, Event, RejectedWrench, RunInfo, Status
from rb_dynamics.recording.state_hash import StateHash
from rb_dynamics.rotation import rotate_inverse

if TYPE_CHECKING:
    from mcap.writer import CompressionType, Writer

    from rb_dynamics.body.rigid_body import RigidBody

# What a kill costs at most.
CHUNK_BYTES = 128 * 1024

POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
SCALAR = "std_msgs/msg/Float64"
INERTIA = "geometry_msgs/msg/InertiaStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

SAMPLE_TOPICS = (
    ("pose", POSE),
    ("twist", TWIST),
    ("odom", ODOMETRY),
    ("angular_momentum", VECTOR),
    ("linear_momentum", VECTOR),
    ("energy/kinetic", SCALAR),
    ("energy/work", SCALAR),
    ("energy/defect", SCALAR),
)

POTENTIAL = ("energy/potential", SCALAR)
"""Where an effect has a potential energy."""

_APPLIED = "/applied"
_FOREVER = "\n    sec: 9223372036\n    nsec: 854775807\n"

# Relative name, message type, QoS.
_Topic = tuple[str, str, str]


def qos_profile(depth: int = 10, durability: str = "volatile") -> str:
    """Return a reliable profile in the words of rosbag2 in Jazzy (bag metadata version 9)."""
    return (
        f"- history: keep_last\n  depth: {depth}\n  reliability: reliable\n  durability: {durability}\n"
        f"  deadline:{_FOREVER}  lifespan:{_FOREVER}"
        f"  liveliness: automatic\n  liveliness_lease_duration:{_FOREVER}"
        "  avoid_ros_namespace_conventions: false"
    )


class McapSink:
    """Writes one run to one file; an earlier file of that name is replaced.

    A killed run leaves a file that is readable up to its last whole chunk.
    """

    def __init__(
        self, path: str | os.PathLike[str], namespace: str = "", remap: Mapping[str, str] | None = None
    ) -> None:
        """Say where to write; nothing is touched before `open`.

        Args:
            path: the file; folders above it are made.
            namespace: put before relative topic names.
            remap: absolute names of single topics, by relative name; they win over `namespace`.
        """
        self._path = Path(path)
        self._namespace = "".join(f"/{part}" for part in namespace.split("/") if part)
        self._remap = dict(remap or {})
        self._ids: dict[str, int] = {}
        self._states = StateHash()
        self._file: _File | None = None

    def open(self, run: RunInfo) -> None:
        """Begin the file: metadata, scene, all channels and the inertia are in it when this returns.

        Raises:
            LogError: the file cannot be written, or two channels have one name.
            MissingExtraError: the package mcap is not installed.
        """
        acting = run.scene.acting
        samples = SAMPLE_TOPICS if acting.potential() is None else (*SAMPLE_TOPICS, POTENTIAL)
        held = [name for name, _ in acting.schedules()]
        topics = self._topics(samples, [channel.topic for channel in run.scene.channels], held)
        self._file, self._writer = _start(self._path)
        self._add = self._writer.add_message
        self._writer.add_metadata("rb_dynamics", _as_utf8({"method": run.method, **run.metadata}))
        self._writer.add_attachment(0, 0, "scene.yaml", "application/yaml", run.scene.text.encode("utf-8", "replace"))
        self._register(topics)
        self._body_frame = run.scene.frames.body_frame
        self._sample_ids = [self._ids[name] for name, _ in samples]
        self._encode_sample = _sample_encoder(run.scene.frames.world_frame, self._body_frame)
        self._write_inertia(run.scene.body, run.scene.initial.time_ns)
        self.flush()

    def write(self, event: Event) -> None:
        """Log one event.

        Raises:
            LogError: the file cannot be written any more; what was written before stays readable.
        """
        if isinstance(event, Sample):
            self._states.update(event)
            self._write_sample(event)
        elif isinstance(event, AppliedWrench):
            self._write_received(event)
            self._write_applied(event)
        elif isinstance(event, RejectedWrench):
            self._write_received(event)
        else:
            self._write_status(event)

    def flush(self) -> None:
        """End the chunk in progress, so that everything up to now survives a kill.

        Raises:
            LogError: the file cannot be written any more.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self, result: Mapping[str, str]) -> None:
        """Write `result` and the index, and close the file; does nothing where nothing is open or writing has failed.

        Raises:
            LogError: the file cannot be written.
        """
        if self._file is None or self._file.closed:
            return
        self.flush()
        facts = {**result, "states_sha256": self._states.hexdigest()}
        self._writer.add_metadata("rb_dynamics.result", _as_utf8(facts))
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def _topics(self, samples: Sequence[tuple[str, str]], wrenches: list[str], held: list[str]) -> list[_Topic]:
        """Return all topics: those of a sample first, commanded wrenches, and those that effects hold.

        Raises:
            LogError: two of them have one absolute name.
        """
        usual = qos_profile()
        topics = [
            *((name, type_name, usual) for name, type_name in samples),
            *((name, WRENCH, usual) for wrench in wrenches for name in (wrench, wrench + _APPLIED)),
            *((name + _APPLIED, WRENCH, usual) for name in held),
            ("inertia", INERTIA, qos_profile(1, "transient_local")),
            ("/diagnostics", DIAGNOSTICS, qos_profile(1)),
        ]
        names = sorted(self._absolute(name) for name, _, _ in topics)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise LogError(
                f"topics {twice} would each be logged twice, expected one channel for each of {names}; "
                "give the wrench channel another topic"
            )
        return topics

    def _absolute(self, name: str) -> str:
        """Return the name under which ROS knows a topic."""
        if name in self._remap:
            return self._remap[name]
        if name.endswith(_APPLIED) and name.removesuffix(_APPLIED) in self._remap:
            return self._remap[name.removesuffix(_APPLIED)] + _APPLIED
        return name if name.startswith("/") else f"{self._namespace}/{name}"

    def _register(self, topics: list[_Topic]) -> None:
        schemas: dict[str, int] = {}
        for name, type_name, qos in topics:
            if type_name not in schemas:
                schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", schema_text(type_name).encode())
            metadata = {"offered_qos_profiles": qos, "topic_type_hash": TYPE_HASHES[type_name]}
            self._ids[name] = self._writer.register_channel(self._absolute(name), "cdr", schemas[type_name], metadata)

    def _write_sample(self, sample: Sample) -> None:
        time_ns = sample.time_ns
        for channel, message in zip(self._sample_ids, self._encode_sample(sample), strict=True):
            self._add(channel, time_ns, message, time_ns)

    def _write_received(self, event: AppliedWrench | RejectedWrench) -> None:
        command = event.received
        if command is not None and event.topic in self._ids:
            # The stamp may be of any clock; the times of the record are simulation time.
            pack = cdr.stamped_packer(WRENCH, command.frame_id)
            message = pack(*cdr.split_stamp(command.stamp_ns), *command.force, *command.torque)
            self._add(self._ids[event.topic], event.time_ns, message, event.time_ns)

    def _write_applied(self, event: AppliedWrench) -> None:
        pack = cdr.stamped_packer(WRENCH, event.frame_id)
        message = pack(*cdr.split_stamp(event.time_ns), *event.force, *event.torque)
        self._add(self._ids[event.topic + _APPLIED], event.time_ns, message, event.time_ns)

    def _write_status(self, event: Status) -> None:
        status = (event.level, event.name, event.message, self._body_frame, list(event.values.items()))
        message = cdr.encode(DIAGNOSTICS, event.time_ns, "", [status])
        self._add(self._ids["/diagnostics"], event.time_ns, message, event.time_ns)

    def _write_inertia(self, body: RigidBody, time_ns: int) -> None:
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia
        values = (body.mass, *body.center_of_mass, xx, xy, xz, yy, yz, zz)
        message = cdr.encode(INERTIA, time_ns, self._body_frame, values)
        self._add(self._ids["inertia"], time_ns, message, time_ns)


def _sample_encoder(world: str, body: str) -> Callable[[Sample], tuple[bytes, ...]]:
    """Return what makes the messages of a sample, in the order of `SAMPLE_TOPICS`."""
    pack_pose, pack_twist = cdr.stamped_packer(POSE, world), cdr.stamped_packer(TWIST, body)
    pack_odometry, pack_vector = cdr.odometry_packer(world, body), cdr.stamped_packer(VECTOR, world)
    pack_scalar = cdr.float64_packer()

    def encode(sample: Sample) -> tuple[bytes, ...]:
        second, nanosecond = cdr.split_stamp(sample.time_ns)
        pose = (*sample.position_world, *sample.orientation_xyzw)
        velocity_body = rotate_inverse(sample.orientation_xyzw, sample.linear_velocity_world)
        twist = (*velocity_body, *sample.angular_velocity_body)
        return (
            pack_pose(second, nanosecond, *pose),
            pack_twist(second, nanosecond, *twist),
            pack_odometry(second, nanosecond, pose, twist),
            pack_vector(second, nanosecond, *sample.angular_momentum_world),
            pack_vector(second, nanosecond, *sample.linear_momentum_world),
            pack_scalar(sample.kinetic_energy),
            pack_scalar(sample.work),
            pack_scalar(sample.energy_defect),
            *(() if sample.potential_energy is None else (pack_scalar(sample.potential_energy),)),
        )

    return encode


def _start(path: Path) -> tuple[_File, Writer]:
    """Return the file and a writer that has begun it; zstd where it is installed."""
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError:
        raise MissingExtraError("mcap", "log", "an MCAP log") from None
    file = _File(path)
    writer = Writer(cast("IO[bytes]", file), CHUNK_BYTES, _compression(CompressionType))
    writer.start("ros2", f"rb_dynamics {version()}")
    return file, writer


def _as_utf8(facts: Mapping[str, str]) -> dict[str, str]:
    """Return texts that can be written: the name of a file need not be UTF-8."""
    return {key: value.encode("utf-8", "replace").decode() for key, value in facts.items()}


def _compression(types: type[CompressionType]) -> CompressionType:
    try:
        import zstandard  # noqa: F401
    except ImportError:
        return types.NONE
    return types.ZSTD


class _File:
    """A file that takes each write whole or raises `LogError`; unbuffered, as the writer hands over whole chunks."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._position = 0
        self._failure: LogError | None = None
        if path.is_dir():
            raise LogError(f"cannot write {path}: it is a directory, expected a file name such as {path / 'run.mcap'}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise LogError(f"cannot write {path}: {error.strerror or error}; give a file you may write") from error

    @property
    def closed(self) -> bool:
        """Whether nothing can be written any more: closed, or failed."""
        return self._file.closed

    def write(self, data: bytes) -> int:
        """Write all of `data`."""
        if self._failure is not None:
            raise self._failure
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise self._failed(error) from error
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the bytes written; a pipe has no other position."""
        return self._position

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def close(self) -> None:
        """Close; the data is on the disk when this returns."""
        try:
            if self._path.is_file():
                os.fsync(self._file.fileno())
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> LogError:
        self._failure = LogError(
            f"cannot go on writing {self._path}: {error.strerror or error}; "
            f"the first {self._position} bytes stand and can be read. Free space or give another file"
        )
        with contextlib.suppress(OSError):
            self._file.close()
        return self._failure
