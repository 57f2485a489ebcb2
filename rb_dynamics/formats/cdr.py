"""CDR bytes of the ROS 2 messages in a log: encode little-endian, decode either endianness.

Each message type is one line of `LAYOUTS`, with nested structures written out flat; other types are unknown here.

CDR (OMG XCDR1): four bytes of encapsulation, then the fields in order, each aligned to its own size counted from the
byte after the encapsulation; a string is its length with the closing NUL, then its bytes.
"""

from __future__ import annotations

import functools
import itertools
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from rb_dynamics.errors import LogError
from rb_dynamics.numerics.nanoseconds import NANOSECONDS, split_stamp

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Times = npt.NDArray[np.int64]
    Numbers = npt.NDArray[np.float64]
    Bytes = npt.NDArray[np.uint8]

# A field is STAMP, STRING, BYTE, the number of float64 in a row, or a list: a sequence of structures of such fields.
Field: TypeAlias = "str | int | list[Field]"

STAMP: Final = "stamp"
STRING: Final = "string"
BYTE: Final = "byte"

_HEADER: tuple[Field, ...] = (STAMP, STRING)

LAYOUTS: dict[str, tuple[Field, ...]] = {
    "geometry_msgs/msg/PoseStamped": (*_HEADER, 7),
    "geometry_msgs/msg/TwistStamped": (*_HEADER, 6),
    "geometry_msgs/msg/AccelStamped": (*_HEADER, 6),
    "geometry_msgs/msg/WrenchStamped": (*_HEADER, 6),
    "geometry_msgs/msg/Wrench": (6,),
    "geometry_msgs/msg/Vector3Stamped": (*_HEADER, 3),
    "geometry_msgs/msg/InertiaStamped": (*_HEADER, 10),
    "geometry_msgs/msg/QuaternionStamped": (*_HEADER, 4),
    "sensor_msgs/msg/MagneticField": (*_HEADER, 3, 9),
    "sensor_msgs/msg/JointState": (*_HEADER, [STRING], [1], [1], [1]),
    "nav_msgs/msg/Odometry": (*_HEADER, STRING, 7, 36, 6, 36),
    "std_msgs/msg/Float64": (1,),
    "diagnostic_msgs/msg/DiagnosticArray": (*_HEADER, [BYTE, STRING, STRING, STRING, [STRING, STRING]]),
    "rosgraph_msgs/msg/Clock": (STAMP,),
    "tf2_msgs/msg/TFMessage": ([*_HEADER, STRING, 7],),
    "geometry_msgs/msg/Pose": (7,),
    "geometry_msgs/msg/Twist": (6,),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (*_HEADER, 7, 36),
    "geometry_msgs/msg/TwistWithCovarianceStamped": (*_HEADER, 6, 36),
    "geometry_msgs/msg/TransformStamped": (*_HEADER, STRING, 7),
    # Element 0 of a covariance is special: -1 there means that nothing was measured.
    "sensor_msgs/msg/Imu": (*_HEADER, 4, 1, 8, 3, 1, 8, 3, 1, 8),
}

_ENCAPSULATION = b"\x00\x01\x00\x00"
_ORIGIN = len(_ENCAPSULATION)
_ZERO_COVARIANCE = bytes(36 * 8)

Packer: TypeAlias = Callable[..., bytes]


def encode(type_name: str, *values: Any) -> bytes:
    """Return the CDR bytes of one message, little endian.

    `values` follow the type's layout: a stamp is integer nanoseconds, a run of float64 a sequence of that length, a
    sequence a list of tuples.
    """
    out = bytearray(_ENCAPSULATION)
    _encode(LAYOUTS[type_name], values, out)
    return bytes(out)


def decode(type_name: str, data: bytes) -> tuple[Any, ...]:
    """Return the values of one message, as `encode` takes them; runs of float64 come as tuples.

    Raises:
        LogError: `data` is cut short, or is not plain CDR.
    """
    if len(data) < _ORIGIN or data[0] != 0 or data[1] > 1:
        raise LogError(
            f"{type_name}: message begins with {data[:_ORIGIN].hex(' ') or 'nothing'}, expected the CDR encapsulation "
            "00 00 or 00 01 and two more bytes; the message is not CDR or is cut short"
        )
    try:
        return _Decoder(data, "<" if data[1] else ">").structure(LAYOUTS[type_name])
    except struct.error:
        raise LogError(
            f"{type_name}: message ends after {len(data)} bytes, before its last field; it was cut short, or is of "
            "another type: record or send it again"
        ) from None
    except UnicodeDecodeError as error:
        raise LogError(
            f"{type_name}: a string in the message is not UTF-8 ({error.reason}); it is damaged, or of another type: "
            "record or send it again"
        ) from None


def numbers(layout: Sequence[Field], values: Sequence[Any]) -> list[float]:
    """Return every float64 among decoded values, in their order."""
    found: list[float] = []
    for field, value in zip(layout, values, strict=True):
        if isinstance(field, int):
            found += value
        elif isinstance(field, list):
            for element in value:
                found += numbers(field, element)
    return found


def with_numbers(layout: Sequence[Field], values: Sequence[Any], found: Iterator[float]) -> tuple[Any, ...]:
    """Return decoded values with the next of `found` in the place of each float64."""
    return tuple(
        [with_numbers(field, element, found) for element in value]
        if isinstance(field, list)
        else tuple(itertools.islice(found, field))
        if isinstance(field, int)
        else value
        for field, value in zip(layout, values, strict=True)
    )


def places(type_name: str, data: bytes) -> tuple[list[int], list[int]]:
    """Return where the stamps are in a message that `decode` accepts, and where its runs of float64."""
    decoder = _Decoder(data, "<" if data[1] else ">")
    return decoder.places(LAYOUTS[type_name])


def like(type_name: str, model: bytes, times_ns: Times, runs: Iterable[Numbers | None]) -> Bytes:
    """Return messages like `model` but for their stamps and, where given, their runs of float64: (n, length).

    Args:
        type_name: of `model`, which `encode` made.
        model: a message.
        times_ns: (n,), of each message.
        runs: (n, width) for each run of float64.
    """
    import numpy as np

    rows = np.tile(np.frombuffer(model, np.uint8), (len(times_ns), 1))
    fill(rows, type_name, model, times_ns, runs)
    return rows


def fill(rows: Bytes, type_name: str, model: bytes, times_ns: Times, runs: Iterable[Numbers | None]) -> None:
    """Make copies of `model`, (n, length), what `like` returns."""
    import numpy as np

    starts, places_of_runs = places(type_name, model)
    stamps = np.stack([times_ns // NANOSECONDS, times_ns % NANOSECONDS], axis=1).astype("<i4")
    parts = [(at, stamps) for at in starts]
    parts += [(at, run.astype("<f8")) for at, run in zip(places_of_runs, runs, strict=True) if run is not None]
    for at, part in parts:
        # Not -1: where commands come by the thousand between two outputs, there is no row that gives the width.
        flat = np.ascontiguousarray(part).view(np.uint8).reshape(len(part), part.shape[1] * part.itemsize)
        rows[:, at : at + flat.shape[1]] = flat


def first_number(type_name: str, data: bytes) -> int:
    """Return where the first float64 begins in a message that `decode` accepts, of a type without sequences."""
    layout = LAYOUTS[type_name]
    texts = layout[: next(place for place, field in enumerate(layout) if isinstance(field, int))]
    decoder = _Decoder(data, "<" if data[1] else ">")
    decoder.structure(texts)
    return decoder.aligned(8)


def transform_places(data: bytes) -> list[tuple[int, str, str, int]]:
    """Return of each transform in a TFMessage: where its stamp begins, its two frames, and where its numbers begin.

    Raises:
        LogError: as `decode`.
    """
    type_name = "tf2_msgs/msg/TFMessage"
    count = len(decode(type_name, data)[0])
    decoder = _Decoder(data, "<" if data[1] else ">")
    # The length of the sequence and a stamp are aligned alike.
    decoder.structure((BYTE, BYTE, BYTE, BYTE))
    found = []
    for _ in range(count):
        stamp_at = decoder.aligned(4)
        _, frame, child = decoder.structure((*_HEADER, STRING))
        found.append((stamp_at, frame, child, decoder.aligned(8)))
        decoder.structure((7,))
    return found


@functools.lru_cache(maxsize=256)
def stamped_packer(type_name: str, *strings: str) -> Packer:
    """Return `pack(sec, nanosec, *numbers)` for a type of stamp, strings and runs of float64, the strings fixed.

    The bytes are those of `encode`, in one call of `struct`.
    """
    count = sum(field for field in LAYOUTS[type_name] if isinstance(field, int))
    text = strings_after_stamp(strings)
    pack_all = struct.Struct(f"<4siI{len(text)}s{count}d").pack

    def pack(seconds: int, nanoseconds: int, *numbers: float) -> bytes:
        return pack_all(_ENCAPSULATION, seconds, nanoseconds, text, *numbers)

    return pack


def covariance(variances: Sequence[float]) -> tuple[float, ...]:
    """Return the 36 numbers of a covariance with these six variances and no correlation."""
    return tuple(variances[row] if row == column else 0.0 for row in range(6) for column in range(6))


def odometry_packer(
    frame_id: str, child_frame_id: str, pose_covariance: Sequence[float] = (), twist_covariance: Sequence[float] = ()
) -> Packer:
    """Return `pack(sec, nanosec, pose, twist)` for nav_msgs/Odometry with both frames fixed.

    Covariances are 36 numbers each, or zero.
    """
    text = strings_after_stamp((frame_id, child_frame_id))
    of_pose, of_twist = (
        struct.pack("<36d", *each) if each else _ZERO_COVARIANCE for each in (pose_covariance, twist_covariance)
    )
    pack_all = struct.Struct(f"<4siI{len(text)}s7d288s6d288s").pack

    def pack(seconds: int, nanoseconds: int, pose: Sequence[float], twist: Sequence[float]) -> bytes:
        return pack_all(_ENCAPSULATION, seconds, nanoseconds, text, *pose, of_pose, *twist, of_twist)

    return pack


def transform_packer(frame_id: str, child_frame_id: str) -> Packer:
    """Return `pack(sec, nanosec, pose)` for tf2_msgs/TFMessage of one transform with both frames fixed."""
    # The stamp follows the length of the sequence; the strings after it begin 4 bytes later than elsewhere.
    out = bytearray(_ORIGIN + 12)
    for name in (frame_id, child_frame_id):
        _append_string(name, out)
    _align(out, 8)
    text = bytes(out[_ORIGIN + 12 :])
    pack_all = struct.Struct(f"<4sIiI{len(text)}s7d").pack

    def pack(seconds: int, nanoseconds: int, pose: Sequence[float]) -> bytes:
        return pack_all(_ENCAPSULATION, 1, seconds, nanoseconds, text, *pose)

    return pack


def float64_packer() -> Packer:
    """Return `pack(number)` for std_msgs/Float64."""
    return functools.partial(struct.Struct("<4sd").pack, _ENCAPSULATION)


def clock_packer() -> Packer:
    """Return `pack(sec, nanosec)` for rosgraph_msgs/Clock."""
    return functools.partial(struct.Struct("<4siI").pack, _ENCAPSULATION)


def strings_after_stamp(strings: Sequence[str]) -> bytes:
    """Return the bytes of strings after a stamp, little endian, padded to where float64 may follow."""
    after_stamp = _ORIGIN + 8
    out = bytearray(after_stamp)
    for text in strings:
        _append_string(text, out)
    _align(out, 8)
    return bytes(out[after_stamp:])


def _align(out: bytearray, size: int) -> None:
    out += bytes(-(len(out) - _ORIGIN) % size)


def _append_string(text: str, out: bytearray) -> None:
    # A lone surrogate (a file name that is not UTF-8) must not stop a log.
    data = text.encode("utf-8", "replace")
    _align(out, 4)
    out += struct.pack("<I", len(data) + 1)
    out += data + b"\0"


def _encode(layout: Sequence[Field], values: Sequence[Any], out: bytearray) -> None:
    for field, value in zip(layout, values, strict=True):
        if isinstance(field, list):
            _align(out, 4)
            out += struct.pack("<I", len(value))
            for element in value:
                _encode(field, element, out)
        elif isinstance(field, int):
            _align(out, 8)
            out += struct.pack(f"<{field}d", *value)
        elif field == STAMP:
            _align(out, 4)
            out += struct.pack("<iI", *split_stamp(value))
        elif field == STRING:
            _append_string(value, out)
        else:
            out.append(value)


class _Decoder:
    """Walks through one message; struct.error where it ends too soon."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data = data
        self._order = order
        self._position = _ORIGIN

    def aligned(self, size: int) -> int:
        """Return where a value of this size would begin."""
        return self._position + -(self._position - _ORIGIN) % size

    def places(self, layout: Sequence[Field]) -> tuple[list[int], list[int]]:
        """Return where stamps and runs of float64 are in one structure."""
        stamps, runs = list[int](), list[int]()
        for field in layout:
            if isinstance(field, list):
                (count,) = self._take("I", 4, 4)
                for _ in range(count):
                    more = self.places(field)
                    stamps, runs = stamps + more[0], runs + more[1]
                continue
            if field == STAMP:
                stamps.append(self.aligned(4))
            elif isinstance(field, int):
                runs.append(self.aligned(8))
            self._field(field)
        return stamps, runs

    def structure(self, layout: Sequence[Field]) -> tuple[Any, ...]:
        """Return the values of one structure."""
        return tuple(self._field(field) for field in layout)

    def _field(self, field: Field) -> Any:
        if isinstance(field, list):
            (count,) = self._take("I", 4, 4)
            # An element takes at least four bytes, so a false count ends at the end of the data, not of the memory.
            return [self.structure(field) for _ in range(count)]
        if isinstance(field, int):
            return self._take(f"{field}d", 8, 8 * field)
        if field == STAMP:
            seconds, nanoseconds = self._take("iI", 4, 8)
            return seconds * NANOSECONDS + nanoseconds
        if field == STRING:
            return self._string()
        return self._take("B", 1, 1)[0]

    def _take(self, what: str, alignment: int, size: int) -> tuple[Any, ...]:
        start = self.aligned(alignment)
        self._position = start + size
        return struct.unpack_from(self._order + what, self._data, start)

    def _string(self) -> str:
        (length,) = self._take("I", 4, 4)
        (text,) = self._take(f"{length}s", 1, length)
        # Some writers give an empty string the length 0, without its NUL.
        return str(text[:-1] if text.endswith(b"\0") else text, "utf-8")
