"""All sensors that a scene can list, by their `type`. A new one is a file with one `Sensor` and an entry here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from rb_dynamics.sensors.attitude_sensors import AttitudeErrorSensor, PoseSensor, StarTracker, SunSensor
from rb_dynamics.sensors.imu import Imu
from rb_dynamics.sensors.magnetometer import Magnetometer
from rb_dynamics.sensors.sensor import Sensor

_ALL: tuple[type[Sensor], ...] = (Imu, StarTracker, Magnetometer, SunSensor, PoseSensor, AttitudeErrorSensor)

SENSORS: Mapping[str, type[Sensor]] = MappingProxyType({sensor.kind: sensor for sensor in _ALL})
"""By the name of their type."""
