"""The node's parameters: its own, with description and range, and the scene's scalar values as overrides."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from rb_dynamics.errors import SceneError
from rb_dynamics.scene import read_scene
from rb_dynamics.scene.model import Scene

# name: (default, what it does)
_PARAMETERS: dict[str, tuple[object, str]] = {
    "scene": ("", "scene file (YAML)"),
    "real_time_factor": (1.0, "simulated seconds per second; 0 runs as fast as possible"),
    "lockstep": (False, "time stands still until every channel's newest stamp allows it to advance"),
    "start_paused": (False, "begin paused; ~/pause and ~/step move time"),
    "publish_clock": (False, "publish simulation time on /clock"),
    "publish_accel": (False, "publish the acceleration of the body origin on accel"),
    "apply_at": ("arrival", "when a command takes effect: at its arrival, or at its header.stamp in simulation time"),
    "mcap": ("", "write an MCAP log to this file"),
    "rerun": ("", "write a Rerun recording to this file"),
}
# Declared by rclpy itself.
_RCLPY = ("use_sim_time", "start_type_description_service", "qos_overrides.")


@dataclass(frozen=True)
class Settings:
    """The node's parameters, validated; see `_PARAMETERS`."""

    scene: Scene
    real_time_factor: float
    lockstep: bool
    start_paused: bool
    publish_clock: bool
    publish_accel: bool
    apply_at: str
    mcap: str
    rerun: str


def read_settings(node: Node) -> Settings:
    """Declare the parameters of `node`, read the scene they name, and apply the others to it as overrides.

    Raises:
        SceneError: a parameter or the scene is not valid.
    """
    values = {name: _declare(node, name, default, text) for name, (default, text) in _PARAMETERS.items()}
    overrides = {}
    # rclpy has no public way to see an override before it is declared.
    for name, parameter in node._parameter_overrides.items():  # noqa: SLF001
        if name not in _PARAMETERS and not name.startswith(_RCLPY):
            overrides[name] = parameter.value
            # Declared, so that `ros2 param list` shows what the scene was changed by.
            _declare(node, name, parameter.value, "overrides the scene's value")
    path = _text("scene", values["scene"])
    if not path:
        raise SceneError("parameter scene: missing, expected a scene file; start with: --ros-args -p scene:=FILE")
    scene = read_scene(path, overrides)
    factor = values["real_time_factor"]
    if isinstance(factor, bool) or not isinstance(factor, (int, float)) or not (math.isfinite(factor) and factor >= 0):
        raise SceneError(f"parameter real_time_factor: found {factor!r}, expected a number of 0 (no limit) or more")
    apply_at = _text("apply_at", values["apply_at"])
    if apply_at not in ("arrival", "stamp"):
        raise SceneError(f"parameter apply_at: found {apply_at!r}, expected 'arrival' or 'stamp'")
    if scene.output_rate == 0 and scene.solver.step is None:
        raise SceneError(
            f"{scene.source}: output_rate: found 0 (every step) with steps chosen by accuracy, which a node cannot "
            "pace; give an output_rate in Hz, or a fixed solver.step"
        )
    return Settings(
        scene,
        float(factor),
        _flag("lockstep", values["lockstep"]),
        _flag("start_paused", values["start_paused"]),
        _flag("publish_clock", values["publish_clock"]),
        _flag("publish_accel", values["publish_accel"]),
        apply_at,
        _text("mcap", values["mcap"]),
        _text("rerun", values["rerun"]),
    )


def _declare(node: Node, name: str, default: object, text: str) -> object:
    # Dynamic typing lets `real_time_factor:=1` be a number like any other; what it has to be is checked here.
    descriptor = ParameterDescriptor(description=text, read_only=True, dynamic_typing=True)
    return node.declare_parameter(name, default, descriptor).value


def _flag(name: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise SceneError(f"parameter {name}: found {value!r}, expected true or false")
    return value


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise SceneError(f"parameter {name}: found {value!r}, expected text; quote it: -p '{name}:=\"{value}\"'")
    return value
