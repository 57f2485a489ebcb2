"""Stop the tumble of config/wheels.yaml and hold the attitude of the world, by IMU, star tracker and three wheels.

Start the node first, in the same environment:

    rb-dynamics node config/wheels.yaml
"""

import contextlib
import signal

import rclpy
from geometry_msgs.msg import QuaternionStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

STIFFNESS, DAMPING = 0.01, 0.05  # N m; N m s/rad
attitude = [0.0, 0.0, 0.0]  # twice the vector part of the last quaternion: small angles, rad


def see(message: QuaternionStamped) -> None:
    q = message.quaternion
    sign = 2.0 if q.w >= 0.0 else -2.0
    attitude[:] = sign * q.x, sign * q.y, sign * q.z


def control(imu: Imu) -> None:
    rate = imu.angular_velocity
    for wheel, angle, turning in zip(wheels, attitude, (rate.x, rate.y, rate.z), strict=True):
        # The torque on the wheel; the body gets the opposite.
        wheel.publish(Float64(data=STIFFNESS * angle + DAMPING * turning))


# Not with rclpy's handlers: they wake the executor before they end the context, and it could then wait forever.
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
signal.signal(signal.SIGTERM, signal.default_int_handler)
node = rclpy.create_node("detumble")
wheels = [node.create_publisher(Float64, f"wheel_{axis}/command", 1) for axis in "xyz"]
node.create_subscription(QuaternionStamped, "tracker", see, 1)
node.create_subscription(Imu, "imu", control, 1)
executor = SingleThreadedExecutor()
executor.add_node(node)
with contextlib.suppress(KeyboardInterrupt):
    while True:
        executor.spin_once(timeout_sec=0.1)
rclpy.shutdown()
