"""Detumble, slew and hold the satellite of config/campaigns/spacecraft, by what its sensors say alone.

The control is that of the campaign, config/campaigns/spacecraft_law.py. Start this first, as the satellite tumbles on
without it, and then the node:

    rb-dynamics node config/campaigns/spacecraft/satellite.yaml --ros-args -p real_time_factor:=10.0
"""

import contextlib
import signal
import sys

import numpy as np
import rclpy
from geometry_msgs.msg import QuaternionStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu, JointState, MagneticField
from std_msgs.msg import Float64

from rb_dynamics.scene.shipped import shipped

sys.path.insert(0, str(shipped("config/campaigns/spacecraft_law.py").parent))
from spacecraft_law import AXES, commands

TARGET = np.array([[0.0, 0.0, 0.5**0.5, 0.5**0.5]])
GAINS = 0.002, 0.02, 0.02  # stiffness, damping, unloading: those of config/campaigns/spacecraft.yaml
heard: dict[str, np.ndarray] = {}


def row(*numbers: float) -> np.ndarray:
    return np.array([numbers])


def see(message: QuaternionStamped) -> None:
    q = message.quaternion
    heard["attitude"] = row(q.x, q.y, q.z, q.w)


def measure(message: MagneticField) -> None:
    field = message.magnetic_field
    heard["field"] = row(field.x, field.y, field.z)


def turn(message: JointState) -> None:
    speeds = dict(zip(message.name, message.velocity, strict=True))
    heard["speeds"] = row(*(speeds[f"wheel_{axis}"] for axis in AXES))


def control(imu: Imu) -> None:
    rate = imu.angular_velocity
    if heard.keys() >= {"attitude", "field", "speeds"}:
        now = heard["attitude"], row(rate.x, rate.y, rate.z), heard["field"], heard["speeds"]
        for name, (value,) in commands(*now, TARGET, *GAINS).items():
            publishers[name].publish(Float64(data=float(value)))


# Not with rclpy's handlers: they wake the executor before they end the context, and it could then wait forever.
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
signal.signal(signal.SIGTERM, signal.default_int_handler)
node = rclpy.create_node("spacecraft")
names = [f"{kind}_{axis}" for kind in ("wheel", "rod") for axis in AXES]
publishers = {name: node.create_publisher(Float64, f"{name}/command", 1) for name in names}
node.create_subscription(QuaternionStamped, "tracker", see, 1)
node.create_subscription(MagneticField, "mag", measure, 1)
node.create_subscription(JointState, "wheels", turn, 1)
node.create_subscription(Imu, "imu", control, 1)
executor = SingleThreadedExecutor()
executor.add_node(node)
with contextlib.suppress(KeyboardInterrupt):
    while True:
        executor.spin_once(timeout_sec=0.1)
rclpy.shutdown()
