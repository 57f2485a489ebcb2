"""The node's parameters: its own, with description and range, and the scene's values under their dotted keys."""

from __future__ import annotations

import contextlib
import difflib
import importlib.util
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter

from rb_dynamics.body.state import State
from rb_dynamics.errors import SceneError, did_you_mean
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.logs.messages import sample_depth
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.ros.publishers import Topics
from rb_dynamics.ros.runner import Mode
from rb_dynamics.scene import read_scene
from rb_dynamics.scene.model import Scene
from rb_dynamics.scene.overrides import root_of
from rb_dynamics.scene.read import ROOT_KEYS
from rb_dynamics.sinks.log_options import LogOptions
from rb_dynamics.sinks.mcap_sink import FLUSH_S, LogSettings

# name: (default, what it does)
_PARAMETERS: dict[str, tuple[object, str]] = {
    "scene": ("", "scene file (YAML)"),
    "real_time_factor": (1.0, "simulated seconds per second, 1e-9 to 1e9; 0 runs as fast as possible"),
    "lockstep": (False, "time advances only as far as the newest stamp of every channel"),
    "start_paused": (False, "start paused; ~/pause and ~/step control time"),
    "publish_clock": (False, "publish simulation time on /clock"),
    "publish_tf": (False, "publish the pose on /tf and the scene's fixed frames on /tf_static"),
    "publish_accel": (False, "publish the acceleration of the body origin on accel"),
    "publish_pose_with_covariance": (False, "publish pose_with_covariance, for filters"),
    "publish_twist_with_covariance": (False, "publish twist_with_covariance, for filters"),
    "pose_covariance": ([1e-12] * 6, "variances in odom and pose_with_covariance: 3 of position, 3 of rotation"),
    "twist_covariance": ([1e-12] * 6, "variances in odom and twist_with_covariance: 3 of velocity, 3 of rate"),
    "stamps": (
        "auto",
        "time of header.stamp: ros, simulation, or auto (ros if time runs at factor 1 from the start, without /clock)",
    ),
    "apply_at": ("arrival", "when a command takes effect: at its arrival, or at its header.stamp"),
    "log_latency": (False, "log when each command was sent, received and applied: <topic>/latency"),
    "deadline": (0.0, "longest time (s) from sending a command to its effect, beyond which it is counted; 0 = none"),
    "mcap": ("", "write an MCAP log to this file; an earlier file is renamed, as for bag and rerun"),
    "bag": ("", "write the log as a rosbag2 folder instead"),
    "max_bag_size": (0, "size in bytes at which the bag starts a new file; 0 = no limit"),
    "max_bag_duration": (0.0, "simulated seconds per file of the bag; 0 = no limit"),
    "flush": (FLUSH_S, "longest wall time (s) of logged data that a kill can lose; 0 = whole chunks only"),
    "verify": (False, "read each finished log back with the package mcap (extra: log)"),
    "rerun": ("", "write a Rerun recording to this file"),
    "sink": ("", "also write the run to another sink, such as that of a plug-in: NAME=TARGET, or a list of these"),
}
# Beyond these, times in ns exceed the precision of a double.
_SLOWEST, _FASTEST = 1e-9, 1e9
# Parameters that may be set while the node runs.
_SETTABLE = ("real_time_factor",)
STATE = {
    "state.position_world": "m, of the body origin",
    "state.orientation": "x, y, z, w: from body to world axes",
    "state.linear_velocity_world": "m/s, of the body origin",
    "state.angular_velocity_body": "rad/s",
}
"""Parameters that move the body when they are set."""
# Declared by rclpy itself.
_QOS = "qos_overrides."
_RCLPY = ("use_sim_time", "start_type_description_service", _QOS)


@dataclass(frozen=True)
class Settings:
    """The node's parameters, validated; see `_PARAMETERS`."""

    scene: Scene
    mode: Mode
    topics: Topics
    use_sim_time: bool
    ros_stamps: bool
    logs: LogOptions


def documented() -> list[tuple[str, object, str]]:
    """Return the node's own parameters: name, default, description."""
    own = [(name, default, text) for name, (default, text) in _PARAMETERS.items()]
    return own + [(name, "", f"moves the body when it is set: {text}") for name, text in STATE.items()]


def read_settings(node: Node, shared: Collection[str] = ()) -> Settings:
    """Declare the parameters of `node`, read the scene they name, and apply the others to it as overrides.

    Unknown ones that are in `shared`, given to all nodes of a graph, are only warned of.

    Raises:
        SceneError: a parameter or the scene is not valid.
        LogError: the requested logs cannot be combined.
    """
    # rclpy has no public way to see an override before it is declared.
    given = node._parameter_overrides  # noqa: SLF001
    overrides = {name: given[name].value for name in given if name not in _PARAMETERS and not name.startswith(_RCLPY)}
    foreign = []
    for name in list(overrides):
        try:
            require_known(name)
        except SceneError:
            if name not in shared:
                raise
            del overrides[name]
            foreign.append(name)
    if foreign:
        names = ", ".join(sorted(foreign))
        node.get_logger().warning(f"unknown parameters that are given to all nodes (/**) are ignored: {names}")
    values = {name: _declare(node, name, default, text) for name, (default, text) in _PARAMETERS.items()}
    path = _text("scene", values["scene"])
    if not path:
        raise SceneError("parameter scene: found nothing, expected a scene file; start with --ros-args -p scene:=FILE")
    scene = read_scene(path, overrides)
    require_paceable(scene)
    factor = real_time_factor(values["real_time_factor"])
    apply_at = _choice("apply_at", values["apply_at"], "arrival", "stamp")
    flags = {name: _flag(name, values[name]) for name, (default, _) in _PARAMETERS.items() if default is False}
    use_sim_time = bool(node.get_parameter("use_sim_time").value)
    if use_sim_time:
        _require_one_master(flags, factor)
    ros_stamps = _ros_stamps(
        _choice("stamps", values["stamps"], "auto", "ros", "simulation"), flags, factor, use_sim_time
    )
    if flags["publish_tf"] and importlib.util.find_spec("tf2_msgs") is None:
        raise SceneError(
            "parameter publish_tf: needs the package tf2_msgs, which is not installed; install ros-jazzy-tf2-msgs "
            "(it is not on PyPI) and source ROS 2, or leave out publish_tf"
        )
    # Declare them, so that `ros2 param list` shows what can be changed.
    for name, value in scene_values(scene).items():
        _declare(node, name, value, "value of the scene; settable while paused")
    initial = scene.initial
    state = (
        *(initial.position_world, initial.orientation_xyzw),
        *(initial.linear_velocity_world, initial.angular_velocity_body),
    )
    for (name, text), value in zip(STATE.items(), state, strict=True):
        _declare(node, name, list(value), f"{text}; setting it moves the body now, to what is set together")
    return Settings(
        scene,
        Mode(
            factor,
            flags["lockstep"],
            flags["start_paused"],
            apply_at,
            flags["log_latency"],
            round(number("deadline", values["deadline"]) * NANOSECONDS),
        ),
        Topics(
            sample_depth(scene),
            flags["publish_clock"],
            flags["publish_tf"],
            flags["publish_accel"],
            flags["publish_pose_with_covariance"],
            flags["publish_twist_with_covariance"],
            _variances("pose_covariance", values["pose_covariance"]),
            _variances("twist_covariance", values["twist_covariance"]),
        ),
        use_sim_time,
        ros_stamps,
        LogOptions(
            _text("mcap", values["mcap"]),
            _text("bag", values["bag"]),
            _text("rerun", values["rerun"]),
            round(number("max_bag_size", values["max_bag_size"])),
            number("max_bag_duration", values["max_bag_duration"]),
            LogSettings(number("flush", values["flush"]), flags["verify"], flags["publish_accel"]),
            _texts("sink", values["sink"]),
            [path],
        ),
    )


def scene_values(scene: Scene) -> dict[str, object]:
    """Return the numbers, texts and lists of numbers in the scene, by their dotted keys."""
    return dict(_leaves(document.parse(scene.text, Problems(scene.source)), ""))


def require_known(name: str) -> None:
    """Check that a parameter belongs to the node or is a key of a scene.

    Raises:
        SceneError: it is neither; the message names the nearest, and all of them.
    """
    section = root_of(name)
    if name in _PARAMETERS or section in ROOT_KEYS:
        return
    known = (*_PARAMETERS, *ROOT_KEYS)
    remedy = did_you_mean(name if "." not in name else section, known, "check the spelling")
    raise SceneError(
        f"parameter {name}: found an unknown name, expected one of {', '.join(_PARAMETERS)}, use_sim_time, or a dotted "
        f"key of the scene ({', '.join(ROOT_KEYS)}), such as body.mass; {remedy}"
    )


def require_paceable(scene: Scene) -> None:
    """Check that the node can know the times of the scene's outputs in advance.

    Raises:
        SceneError: it cannot.
    """
    if scene.output_rate == 0 and scene.solver.step is None:
        raise SceneError(
            f"{scene.source}: output_rate: found 0 (every step) with steps chosen by accuracy, which a node cannot "
            "pace; give an output_rate in Hz, or a fixed solver.step"
        )


def remap_overrides(node: Node) -> None:
    """Let QoS overrides that name a topic as it is before remapping apply to it; before the topics exist."""
    # As in `read_settings`.
    given = node._parameter_overrides  # noqa: SLF001
    for name in [name for name in given if name.startswith(_QOS)]:
        topic, *policy = name.removeprefix(_QOS).split(".", maxsplit=1)
        with contextlib.suppress(NameValidationException):
            remapped = _QOS + ".".join([node.resolve_topic_name(topic), *policy])
            if remapped != name:
                value = given.pop(name).value
                given.setdefault(remapped, Parameter(remapped, value=value))


def require_overridable(node: Node, elsewhere: Sequence[str] = (), shared: Collection[str] = ()) -> None:
    """Check that each QoS override applies to a topic of `node`, once its topics exist.

    Overrides for topics in the namespaces `elsewhere`, and those that are `shared` by all nodes, need not.

    Raises:
        SceneError: there is no such topic or policy; the message names the nearest.
    """
    known = [_QOS + name for name in node.get_parameters_by_prefix(_QOS.rstrip("."))]
    # As in `read_settings`.
    for name in node._parameter_overrides:  # noqa: SLF001
        topic, _, policy = name.removeprefix(_QOS).partition(".")
        others = tuple(f"/{other.strip('/')}/" for other in elsewhere)
        if not name.startswith(_QOS) or name in known or topic.startswith(others) or name in shared:
            continue
        topics = list(dict.fromkeys(each.split(".")[1] for each in known))
        likely = difflib.get_close_matches(topic, topics, n=1)
        there = [each for each in known if each.split(".")[1] in likely]
        near = [each for each in there if each.endswith(f".{policy}")] or there
        remedy = f"did you mean {' or '.join(near)}?" if near else f"there are those of {', '.join(topics)}"
        if node.get_parameter("lockstep").value and policy.startswith("subscription"):
            remedy = "in lockstep no command may be lost, and none can be overridden: leave it out"
        raise SceneError(
            f"parameter {name}: found no topic that it applies to, expected a topic of this node, by its name before "
            f"or after remapping, and a policy that can be overridden; {remedy}"
        )


def scene_overrides(parameters: Iterable[Parameter]) -> dict[str, object]:
    """Return those of `parameters`, set while the node runs, that change the scene.

    Raises:
        SceneError: one is unknown, deleted, or cannot be changed now.
    """
    overrides = {}
    for parameter in parameters:
        name = parameter.name
        if parameter.type_ == Parameter.Type.NOT_SET:
            raise SceneError(f"parameter {name}: cannot be deleted; set another value")
        if name.startswith(_RCLPY):
            raise SceneError(f"parameter {name}: cannot be changed while the node runs; start it anew")
        if name in STATE:
            continue
        require_known(name)
        if name not in _SETTABLE:
            overrides[name] = parameter.value
    return overrides


def changed_state(parameters: Iterable[Parameter], state: State) -> State | None:
    """Return `state` with the parts that `parameters` set, whatever they are; None if they set nothing."""
    values: dict[str, Any] = {each.name.removeprefix("state."): each.value for each in parameters if each.name in STATE}
    if "orientation" in values:
        values["orientation_xyzw"] = values.pop("orientation")
    return replace(state, **values) if values else None


def number(name: str, value: object) -> float:
    """Return the value of a parameter that must be a finite number, at least 0.

    Raises:
        SceneError: it is not.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not (math.isfinite(value) and value >= 0):
        raise SceneError(
            f"parameter {name}: found {value!r}, expected a number of 0 (no limit) or more; write such a number"
        )
    return float(value)


def real_time_factor(value: object) -> float:
    """Return a real-time factor that can be computed with in ns, or 0.

    Raises:
        SceneError: it is out of range.
    """
    factor = number("real_time_factor", value)
    if factor and not _SLOWEST <= factor <= _FASTEST:
        raise SceneError(
            f"parameter real_time_factor: found {factor:g}, expected 0 (as fast as possible) or a number from "
            f"{_SLOWEST:g} to {_FASTEST:g}; write such a number"
        )
    return factor


def _require_one_master(flags: dict[str, bool], factor: float) -> None:
    for name, wrong, reason in (
        ("publish_clock", flags["publish_clock"], "the node would wait for its own clock"),
        ("lockstep", flags["lockstep"], "in lockstep the commands move time"),
        ("real_time_factor", factor != 1.0, "the clock that is followed sets the pace"),
    ):
        if wrong:
            raise SceneError(
                f"parameter use_sim_time: found true together with {name}, expected one master of time, as {reason}; "
                f"leave out one of them"
            )


def _ros_stamps(stamps: str, flags: dict[str, bool], factor: float, use_sim_time: bool) -> bool:
    """Return whether messages are stamped with ROS time by this node's own clock."""
    why_not = {
        "lockstep:=true": flags["lockstep"],
        f"real_time_factor:={factor:g}": factor != 1.0,
        "publish_clock:=true": flags["publish_clock"],
    }
    others = [name for name, given in why_not.items() if given]
    if stamps == "ros" and others:
        raise SceneError(
            f"parameter stamps: found 'ros' together with {others[0]}, with which time is not that of other clocks, "
            "expected 'simulation' or 'auto'; leave out one of them"
        )
    if stamps == "simulation" and use_sim_time:
        raise SceneError(
            "parameter stamps: found 'simulation' together with use_sim_time, with which stamps are those of /clock, "
            "expected 'ros' or 'auto'; leave out one of them"
        )
    if use_sim_time or stamps == "simulation":
        return False
    return stamps == "ros" or not (others or flags["start_paused"])


def _leaves(node: document.Node, key: str) -> Iterator[tuple[str, object]]:
    if isinstance(node.value, dict):
        for name, child in node.value.items():
            yield from _leaves(child, document.join(key, name))
    elif isinstance(node.value, list):
        numbers = [item.value for item in node.value]
        if numbers and all(isinstance(item, float) for item in numbers):
            yield key, numbers
            return
        for index, child in enumerate(node.value):
            yield from _leaves(child, f"{key}[{index}]")
    elif node.value is not None:
        yield key, node.value


def _declare(node: Node, name: str, default: object, text: str) -> object:
    # Dynamic typing accepts `real_time_factor:=1` as a number; the type is checked here.
    read_only = name in _PARAMETERS and name not in _SETTABLE
    descriptor = ParameterDescriptor(description=text, read_only=read_only, dynamic_typing=True)
    return node.declare_parameter(name, default, descriptor).value


def _flag(name: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise SceneError(f"parameter {name}: found {value!r}, expected true or false; write {name}:=true")
    return value


def _text(name: str, value: object) -> str:
    if not isinstance(value, str):
        raise SceneError(f"parameter {name}: found {value!r}, expected text; quote it: -p '{name}:=\"{value}\"'")
    return value


def _choice(name: str, value: object, *choices: str) -> str:
    if value not in choices:
        expected = f"{', '.join(map(repr, choices[:-1]))} or {choices[-1]!r}"
        raise SceneError(f"parameter {name}: found {value!r}, expected {expected}; write one of them")
    return str(value)


def _variances(name: str, value: object) -> tuple[float, ...]:
    found = list(value) if isinstance(value, Iterable) and not isinstance(value, str) else []
    if len(found) != 6 or not all(isinstance(each, (int, float)) and 0.0 <= each < math.inf for each in found):
        raise SceneError(
            f"parameter {name}: found {value!r}, expected six variances of 0 or more; write a list of them"
        )
    return tuple(map(float, found))


def _texts(name: str, value: object) -> list[str]:
    return [_text(name, text) for text in (value if isinstance(value, list) else [value]) if text]
