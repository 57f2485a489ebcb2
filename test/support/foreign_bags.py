"""Bags of a body that tumbles, as other programs record it: written by rosbags, by its own definitions of messages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tumbling import Tumble

from rb_dynamics.numerics.rotation_arrays import rotate_all_inverse

pytest.importorskip("rosbags", reason="extra 'log' is not installed")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
GEOMETRY, SENSOR = "geometry_msgs/msg/", "sensor_msgs/msg/"
IMU, TF = f"{SENSOR}Imu", "tf2_msgs/msg/TFMessage"

# Topic, type, log time, message of rosbags.
Row = tuple[str, str, int, Any]


def write_bag(folder: Path, rows: Iterable[Row], sqlite: bool = False) -> Path:
    """Write rows to a bag, as a folder of rosbag2."""
    storage = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for topic, type_name, log_time, message in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=STORE)
            writer.write(connections[topic], log_time, STORE.serialize_cdr(message, type_name))
    return folder


def of(name: str, *values: Any) -> Any:
    """Return a message of a type of geometry_msgs, or of the package that is named."""
    return STORE.types[name if "/" in name else GEOMETRY + name](*values)


def header(stamp_ns: int, frame: str) -> Any:
    time = of("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
    return of("std_msgs/msg/Header", time, frame)


def pose(row: Any) -> Any:
    return of("Pose", of("Point", *row[:3]), of("Quaternion", *row[3:]))


def twist(row: Any) -> Any:
    return of("Twist", of("Vector3", *row[:3]), of("Vector3", *row[3:]))


def transform(stamp_ns: int, frame: str, child: str, row: Any) -> Any:
    inner = of("Transform", of("Vector3", *row[:3]), of("Quaternion", *row[3:]))
    return of("TransformStamped", header(stamp_ns, frame), child, inner)


def transforms(parts: Iterable[Any]) -> Any:
    return of(TF, list(parts))


def imu(stamp_ns: int, attitude: Any, rate: Any, force: Any, measured: tuple[bool, bool, bool]) -> Any:
    """Return an Imu; what it does not measure has -1 in element 0 of its covariance."""
    parts: list[Any] = []
    for row, kind, told in zip((attitude, rate, force), ("Quaternion", "Vector3", "Vector3"), measured, strict=True):
        covariance = np.zeros(9)
        covariance[0] = 0.01 if told else -1.0
        parts += [of(kind, *row), covariance]
    return of(IMU, header(stamp_ns, "imu_link"), *parts)


def poses_of(motion: Tumble) -> Any:
    """Return rows of position and quaternion."""
    return np.hstack([motion.position, motion.orientation_xyzw])


def twists_of(motion: Tumble) -> Any:
    """Return rows of velocity and rate, body axes."""
    return np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])
