"""Run the real node in its own process and talk to it over DDS."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3, WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from std_srvs.srv import SetBool, Trigger

ROOT = Path(__file__).resolve().parents[2]
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
TRANSIENT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TIMEOUT = 40.0


def values(message: Any) -> dict[str, str]:
    """Return the values of a diagnostics message."""
    return {pair.key: pair.value for pair in message.status[0].values}


def stamp(message: Any) -> int:
    """Return the stamp of a message, ns."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def node_arguments(scene: Path | str, *ros_args: str, **parameters: object) -> list[str]:
    """Return the command line of a node that runs `scene`; `__` in the name of a parameter stands for a dot."""
    arguments = ["node", str(scene), "--ros-args"]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ["-p", f"{name.replace('__', '.')}:={text}"]
    return [*arguments, *ros_args]


class NodeProcess:
    """A node that runs `scene`; arguments as for `node_arguments`."""

    def __init__(self, scene: Path | str, *ros_args: str, **parameters: object) -> None:
        arguments = [sys.executable, "-m", "rb_dynamics", *node_arguments(scene, *ros_args, **parameters)]
        # Where it crashes stands in `err` then.
        environment = os.environ | {"PYTHONFAULTHANDLER": "1"}
        self.process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment
        )

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Return the exit code when the node has ended; fails with what it said if it does not."""
        try:
            self.out, self.err = self.process.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.out, self.err = self.process.communicate()
            raise AssertionError(f"the node did not end: {self.out}{self.err}") from None
        return self.process.returncode


@contextlib.contextmanager
def running(scene: Path | str, *ros_args: str, **parameters: object) -> Iterator[NodeProcess]:
    """Run a node and make sure that it is gone afterwards; if the test did not end it, what it said is written."""
    node = NodeProcess(scene, *ros_args, **parameters)
    try:
        yield node
    finally:
        if node.process.returncode is None:
            ended = node.process.poll()
            node.process.kill()
            out, err = node.process.communicate()
            state = "not ended" if ended is None else f"ended with {ended}"
            sys.stderr.write(f"the node had {state}, and said:\n{out}{err}\n")


class Peer:
    """The test's node: publishes wrenches, keeps received messages, calls services."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context, args=[])
        self.node = Node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = {}
        self._publishers: dict[str, Any] = {}

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def listen(self, kind: type, topic: str, qos: QoSProfile = KEEP_ALL) -> list[Any]:
        """Subscribe, wait until a publisher is there, and return the list that fills."""
        messages = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)
        self.until(lambda: self.node.count_publishers(topic) > 0, f"a publisher of {topic}")
        return messages

    def wrench(
        self,
        topic: str = "wrench",
        force: tuple[float, float, float] = (0.0, 0.0, 0.0),
        torque: tuple[float, float, float] = (0.0, 0.0, 0.0),
        frame_id: str = "",
        stamp_ns: int = 0,
    ) -> None:
        """Publish one command, once the node listens."""
        if topic not in self._publishers:
            publisher = self._publishers[topic] = self.node.create_publisher(WrenchStamped, topic, KEEP_ALL)
            self.until(lambda: publisher.get_subscription_count() > 0, f"a reader of {topic}")
            # The reader may find the writer a little later, and miss what is sent before.
            self.spin(0.1)
        message = WrenchStamped()
        message.header.frame_id = frame_id
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        message.wrench.force = Vector3(x=force[0], y=force[1], z=force[2])
        message.wrench.torque = Vector3(x=torque[0], y=torque[1], z=torque[2])
        self._publishers[topic].publish(message)

    def call(self, service: str, request: Any, kind: type | None = None) -> Any:
        """Call a service of the node and return the answer; `kind` is its type, if it is not of std_srvs."""
        kind = kind or (SetBool if isinstance(request, SetBool.Request) else Trigger)
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, f"the service {service}")
        future = client.call_async(request)
        self.until(future.done, f"an answer of {service}")
        return future.result()

    def diagnostics(self) -> list[Any]:
        return self.listen(DiagnosticArray, "/diagnostics")

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Spin until `condition` holds; fail with `what` was expected."""
        give_up = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > give_up:
                raise AssertionError(f"waited {TIMEOUT:g} s for {what}; {self._last_report()}")
            self.executor.spin_once(timeout_sec=0.02)

    def _last_report(self) -> str:
        reports = self.heard.get("/diagnostics", [])
        if not reports:
            return "no diagnostics were heard"
        last = reports[-1]
        return f"{len(reports)} diagnostics were heard, the last: {last.status[0].message}: {values(last)}"

    def spin(self, seconds: float) -> None:
        """Keep listening for a while."""
        stop = time.monotonic() + seconds
        while time.monotonic() < stop:
            self.executor.spin_once(timeout_sec=0.02)
