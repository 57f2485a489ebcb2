"""Turn the body to TARGET and hold it there: PD control of its attitude, closed over DDS in twenty lines.

Start the node first, in the same environment:

    rb-dynamics node config/free_flyer.yaml

Each command is stamped for the output after the one it answers: that counts where the node goes by stamps.
"""

import contextlib
import signal

import rclpy
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time

TARGET, STIFFNESS, DAMPING = (0.5, 0.5, 0.5, 0.5), 5.0, 1.6  # x, y, z, w; N m; N m s/rad
PERIOD = Duration(seconds=0.01)  # of the outputs


def regulate(odom: Odometry) -> None:
    q, rate, (a, b, c, d) = odom.pose.pose.orientation, odom.twist.twist.angular, TARGET
    # The shorter rotation from TARGET to the present attitude; body axes.
    shorter = 1.0 if d * q.w + a * q.x + b * q.y + c * q.z >= 0.0 else -1.0
    x = shorter * (d * q.x - a * q.w - b * q.z + c * q.y)
    y = shorter * (d * q.y - b * q.w - c * q.x + a * q.z)
    z = shorter * (d * q.z - c * q.w - a * q.y + b * q.x)
    command = WrenchStamped()
    command.header.frame_id = odom.child_frame_id
    command.header.stamp = (Time.from_msg(odom.header.stamp) + PERIOD).to_msg()
    command.wrench.torque.x = -STIFFNESS * x - DAMPING * rate.x
    command.wrench.torque.y = -STIFFNESS * y - DAMPING * rate.y
    command.wrench.torque.z = -STIFFNESS * z - DAMPING * rate.z
    commands.publish(command)


# Not with rclpy's handlers: they wake the executor before they end the context, and it could then wait forever.
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
signal.signal(signal.SIGTERM, signal.default_int_handler)
node = rclpy.create_node("attitude_controller")
commands = node.create_publisher(WrenchStamped, "wrench", 1)
node.create_subscription(Odometry, "odom", regulate, 1)
executor = SingleThreadedExecutor()
executor.add_node(node)
with contextlib.suppress(KeyboardInterrupt):
    while True:
        executor.spin_once(timeout_sec=0.1)
rclpy.shutdown()
