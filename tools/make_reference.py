"""Write docs/reference from the code: scene keys, command line, node, log and Python API.

    python tools/make_reference.py            # the page of the node needs rclpy
    python tools/make_reference.py --check    # prints what is out of date, exit code 1

Sources: keys, expected values and defaults come from the scene reader, which gets a wrong value for each key; options
from the parsers; topics and services from a running node; channels and metadata from a log written for this. The
purpose of each item is a line in the tables below; a missing line is an error.
"""

from __future__ import annotations

import argparse
import copy
import difflib
import importlib
import inspect
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import python_api
import yaml

import rb_dynamics as rb
from rb_dynamics.body.shapes import SHAPES
from rb_dynamics.cli import COMMANDS
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.actuator_types import ACTUATORS
from rb_dynamics.loads.effect_types import EFFECTS
from rb_dynamics.loads.magnetic_field import MODELS
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import read_wrenches
from rb_dynamics.motion import METHODS
from rb_dynamics.run.input_hash import InputHash
from rb_dynamics.sensors.axis_errors import AXIS_KEYS, AxisErrors
from rb_dynamics.sensors.sensor import COMMON_KEYS, Sensor
from rb_dynamics.sensors.sensor_types import SENSORS
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.state_hash import StateHash

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "reference"
NOTE = "*Written by `tools/make_reference.py` from the code.*\n"

UNKNOWN = "no_such_key"
SMALLEST: dict[str, Any] = {"body": {"mass": 1.0, "inertia": {"diagonal": [1.0, 1.0, 1.0]}}}

# Sections of a scene: heading, path, and a scene that contains the section.
SECTIONS: list[tuple[str, str, dict[str, Any]]] = [
    ("Top level", "", SMALLEST),
    ("body", "body", SMALLEST),
    ("body.inertia", "body.inertia", {"body": {"mass": 1.0, "inertia": {}}}),
    ("body.inertia.principal", "body.inertia.principal", {"body": {"mass": 1.0, "inertia": {"principal": {}}}}),
    ("body.inertia.particles[]", "body.inertia.particles[0]", {"body": {"inertia": {"particles": [{}]}}}),
    ("body.inertia.mesh", "body.inertia.mesh", {"body": {"inertia": {"mesh": {}}}}),
    ("body.inertia.urdf", "body.inertia.urdf", {"body": {"inertia": {"urdf": {}}}}),
    ("body.frames.NAME", "body.frames.NAME", {"body": SMALLEST["body"] | {"frames": {"NAME": {}}}}),
    ("initial", "initial", SMALLEST | {"initial": {}}),
    ("continues", "continues", SMALLEST | {"continues": {"after_ns": 0}}),
    ("wrenches[]", "wrenches[0]", SMALLEST | {"wrenches": [{}]}),
    ("solver", "solver", SMALLEST | {"solver": {}}),
]

SCENE = """\
A scene is one YAML file that defines the body, its initial state, what acts on it, and how the motion is computed.
Every key is checked. Units are SI; vectors are `[x, y, z]`; a name that ends in `_world` or `_body` gives the axes of
its vector. Any value can be overridden by its dotted key: `--set body.mass=2`, or a parameter of the node.

[config/slew.yaml](../../config/slew.yaml) is a complete scene with comments.
"""

SHAPE = """\
The keys are `type`, the lengths below in m, `density` (kg/m³) or `body.mass`, and `orientation` (from shape to body
axes).
"""

CLI = """\
`rb-dynamics COMMAND --help` prints the same. Exit codes: 0 done, 1 ran but failed its check, 2 bad input (with one
message and no traceback). A progress bar appears only on a terminal.
"""

LOG = """\
A log is one MCAP file of profile `ros2`, with CDR messages, and `ros2msg` schemas, QoS and type hashes on every
channel. All times are simulation time in nanoseconds, counted from 0, except the `header.stamp` of commands, which is
the sender's; `rb_dynamics.epoch` has the ROS time of time 0 if a node stamped its messages with that.
[Logs](../logs.md) explains how to write, check and view it.
"""

NODE = """\
Names are relative and can be remapped. Every topic is RELIABLE; except in lockstep, publishers of wrenches may be
BEST_EFFORT. Stamps are ROS time or simulation time, see `stamps` below; none is zero. A topic without subscribers is
not computed. [The node in a ROS 2 graph](../ros.md) explains the node's behaviour.
"""

OF_SCENE = """\
Each actuator of the scene is commanded on `<name>/command` (`std_msgs/msg/Float64`); `wheels` has the speeds of all
reaction wheels (`sensor_msgs/msg/JointState`), `energy/motor_work` and `energy/friction_heat` (`std_msgs/msg/Float64`,
J) the work of their motors and the heat of their friction. Each sensor publishes on its name:
[scene](scene.md#sensors).
"""

PARAMETERS = """\
With `use_sim_time`, simulation time follows `/clock`. Numbers, strings and lists of numbers of the scene are parameters
too, under their dotted keys, such as `body.mass`; they may be changed while the node is paused. `ros2 param list` also
shows `start_type_description_service` of rclpy and, where given, `qos_overrides` ([QoS](../ros.md#qos)).
"""

MANAGED = """\
`ros2 run rb_dynamics lifecycle` is [a managed node](../ros.md#lifecycle), `rigid_body_lifecycle`, that makes the node
above when it is configured. It takes the parameters of that node, publishes `~/transition_event`
(`lifecycle_msgs/msg/TransitionEvent`), and has the services for its own parameters and types, as above, and these:
"""

MEANING = {
    "world_frame": "name of the inertial frame",
    "body": "mass properties and frames of the body",
    "initial": "state at time 0; by default at rest at the origin, with the identity orientation",
    "wrenches": "channels of wrench commands; their wrenches add up; `[]` for none",
    "effects": "what else acts on the body; an effect that is not listed is not modelled and costs nothing",
    "actuators": "devices that are each commanded by a number, on the topic `<name>/command`",
    "sensors": "devices that measure the motion, each on a topic of its own; they do not affect the motion",
    "seed": "seed of the sensors' noise: the same seed gives the same bits",
    "solver": "how the motion is computed",
    "duration": "s; `simulate` needs it here or as `--duration`; a node without it runs until it is stopped",
    "output_rate": "Hz, of published and logged states; 0: every step",
    "continues": "the run that this scene continues, as `convert --at` writes it; without it, balances start at zero",
    "continues.after_ns": "ns, the time in that run at which this scene begins",
    "continues.duration": "s, planned duration of that run; absent if it was open-ended",
    "continues.initial": "state at time 0 of that run, as in `initial`",
    "continues.commands": "its commands until then, each `[time_ns, channel, frame_id, force x, y, z, torque x, y, z]`",
    "body.frame": "name of the frame fixed to the body",
    "body.mass": "kg; not together with particles or urdf, which define it",
    "body.center_of_mass": "m, from the body origin, body axes",
    "body.inertia": "about the centre of mass, body axes, kg m²; exactly one form; without it the body is a particle",
    "body.frames": "named frames fixed to the body, in which a wrench may be given",
    "body.inertia.matrix": "`[[Ixx, Ixy, Ixz], [Ixy, Iyy, Iyz], [Ixz, Iyz, Izz]]`, with Ixy = −∫ xy dm",
    "body.inertia.diagonal": "`[Ixx, Iyy, Izz]`, if the body axes are principal axes",
    "body.inertia.principal": "principal moments, and the rotation from principal to body axes",
    "body.inertia.particles": "a list; mass and centre of mass are computed from it",
    "body.inertia.shape": "a textbook shape, see below",
    "body.inertia.mesh": "a closed surface (extra `mesh`); the centre of mass is computed from it",
    "body.inertia.urdf": "a link of a URDF with everything fixed to it; mass and centre of mass are read from it",
    "body.inertia.principal.moments": "kg m²",
    "body.inertia.principal.orientation": "rotation from principal to body axes",
    "body.inertia.particles[0].mass": "kg",
    "body.inertia.particles[0].position": "m, from the body origin, body axes",
    "body.inertia.mesh.file": "STL, OBJ or PLY; relative to the scene file",
    "body.inertia.mesh.density": "kg/m³; or `body.mass`",
    "body.inertia.mesh.scale": "m per unit of the file",
    "body.inertia.urdf.file": "relative to the scene file",
    "body.inertia.urdf.link": "name of the link whose axes are the body axes; links on fixed joints count too",
    "body.frames.NAME.position": "m, from the body origin, body axes",
    "body.frames.NAME.orientation": "rotation from this frame to body axes",
    "initial.position_world": "m, of the body origin",
    "initial.orientation": "rotation from body to world axes, named by component",
    "initial.linear_velocity_world": "m/s, of the body origin",
    "initial.linear_velocity_body": "the same in body axes, in place of `linear_velocity_world`",
    "initial.angular_velocity_body": "rad/s",
    "wrenches[0].topic": "name of the topic",
    "wrenches[0].timeout": "s after its last command at which the channel drops to zero; 0: it holds forever",
    "wrenches[0].optional": "in lockstep, time does not wait for the first command of this channel",
    "wrenches[0].max_force": "N, the largest force of a command; none by default",
    "wrenches[0].max_torque": "N m, the largest torque of a command (without the moment of its force); none by default",
    "wrenches[0].delay": "s from a command to its effect",
    "wrenches[0].lag": "s, time constant with which the acting wrench follows the command (first order)",
    "wrenches[0].bias": "`{force: [x, y, z], torque: [x, y, z]}` in body axes: always acts, from time 0 on",
    "wrenches[0].on_excess": "whether a command beyond a limit is rejected or scaled down to the limit",
    "solver.method": "`auto` or the name of a method: [Set the solver](../how-to/solver.md)",
    "solver.accuracy": "error accepted at the end: attitude in rad, position relative to the distance travelled",
    "solver.step": "s; instead of an accuracy",
    "volume": "m³, of the displaced fluid",
    "density": "kg/m³, of the fluid",
    "center_body": "m, the centre of buoyancy, from the body origin, body axes",
    "acceleration_world": "m/s², of gravity; the force has a potential energy",
    "gravitational_parameter": "μ = G M, m³/s²",
    "center_world": "m, position of the attracting centre, of the dipole, or of the centre of the Earth",
    "gravity_gradient": "also apply the torque and the force that the gradient of gravity over the body causes",
    "translation": "N s/m (linear) or N s²/m² (quadratic); one number, or one for each body axis",
    "rotation": "N m s/rad or N m s²/rad²; one number, or one for each body axis",
    "medium_velocity_world": "m/s, of the medium",
    "axis_body": "direction of the wheel's axis",
    "axial_inertia": "kg m², of the wheel about its axis",
    "spin_rate": "rad/s relative to the body; a number, or `[{time:, rate:}, ...]`, linear between entries",
    "frame_id": "axes and point of application of the wrenches, as in a message header",
    "model": "`uniform`, `dipole` or `igrf`",
    "field_world": "T, of a uniform field",
    "moment_world": "A m², of a dipole",
    "epoch": "UTC of time 0 for `igrf`, ISO 8601, such as 2025-06-01T12:00:00Z",
    "axis": "direction of its axis, body axes",
    "inertia": "kg m², of the wheel about its axis; contained in `body.inertia`",
    "max_torque": "N m of the motor; none by default, required for a commanded speed",
    "max_speed": "rad/s relative to the body; none by default",
    "friction": "`{coulomb: N m, viscous: N m s/rad}`; none by default",
    "speed": "rad/s relative to the body at the start",
    "imbalance": "`{static: kg m, dynamic: kg m², phase: rad at the start}`; none by default",
    "position": "m, of the wheel, body axes, from the body origin; required with a static imbalance",
    "max_dipole": "A m²; a larger command is clipped",
    "force": "N, along the x axis of its frame",
    "command": "what a command means: `on_time` (s) or `level` (0 to 1); of a wheel `torque` or `speed` (N m, rad/s)",
    "minimum_on": "s; a shorter on-time is rejected",
    "rise": "s from no force to full force, linearly",
    "fall": "s from full force to none, linearly",
    "name": "its topic, or the first part of its topics",
    "rate": "Hz, of samples in simulation time",
    "frame": "one of `body.frames`, which gives its position and axes",
    "delay": "s, from a command to its effect, or from a sample to its message",
    "dropout": "probability that a sample gives no message",
    "gyro": "errors of the gyros, in rad/s, see below",
    "accelerometer": "errors of the accelerometers, in m/s², see below",
    "noise": "rad, standard deviation of the angle about each axis in every sample",
    "noise_density": "unit/√Hz, white noise",
    "random_walk": "unit/√s, of the bias",
    "bias": "one number for all axes, or one for each",
    "scale": "relative error of scale; one number for all axes, or one for each",
    "misalignment": "rad, rotation vector by which a true vector is turned; the sensitive axes turn the other way",
    "range": "largest magnitude of each component, at least `resolution`; none by default",
    "resolution": "each component is rounded to a whole multiple of it; none by default",
    "position_noise": "m, standard deviation of each coordinate in every sample",
    "orientation_noise": "rad, likewise of the angle about each axis",
    "direction_world": "direction of the sun",
    "field_of_view": "rad, largest angle between the sun and the x axis of its frame",
    "target": "`{x:, y:, z:, w:}`, rotation from its frame to the world that the body is to have",
    "schedule": "`[{time:, force:, torque:}, ...]`, each held until the next; s, N, N m",
}

ACTS = {
    "uniform_gravity": "Constant gravity, m g. Has a potential energy.",
    "central_gravity": "Attraction by a centre. Has a potential energy. Varies within a step.",
    "linear_drag": "Drag proportional to the speed through a medium, with `translation`, `rotation` or both. "
    "Varies within a step.",
    "quadratic_drag": "Drag proportional to the square of the speed through a medium, with `translation`, `rotation` "
    "or both. Varies within a step.",
    "rotor": "A spinning wheel in the body (gyrostat). Its momentum and energy are included in the balances.",
    "scheduled_wrench": "Wrenches given in the scene as a function of time.",
    "buoyancy": "Buoyancy: minus the weight of the displaced fluid, at the centre of buoyancy. Has a potential energy.",
    "magnetic_field": "A magnetic field, for magnetometers and magnetorquers. Exerts no force of its own.",
}

DRIVES = {
    "reaction_wheel": "A wheel whose speed is a state of the run, with friction, limits and imbalance.",
    "thruster": "A force in pulses or at a level.",
    "magnetorquer": "A dipole in the magnetic field; `effects` must have a `magnetic_field`.",
}

MEASURES = {
    "imu": "Angular velocity and specific force.",
    "star_tracker": "Rotation from its frame to the world.",
    "magnetometer": "Magnetic flux density, in T; `effects` must have a `magnetic_field`.",
    "sun_sensor": "Direction of the sun in its axes; no message while the sun is out of its view.",
    "pose": "Position and attitude of its frame, as motion capture gives them.",
    "attitude_error": "Rotation vector from a target to its attitude, in rad; its length is the pointing error.",
}

EXAMPLES = {kind: f"config/{kind}.yaml" for kind in ACTS} | {"uniform_gravity": "config/boxes.yaml"}

TOPICS = {
    "pose": "of the body origin, world frame",
    "twist": "of the body origin, body axes",
    "odom": "pose and twist; twist in body axes; variances as in `pose_covariance` and `twist_covariance` (log: 0)",
    "angular_momentum": "world axes, about the centre of mass",
    "linear_momentum": "world axes",
    "energy/kinetic": "J",
    "energy/work": "J, done by wrenches and effects",
    "energy/defect": "J, T − T₀ − work",
    "energy/potential": "J, if an effect has one",
    "wheels": "speeds of the reaction wheels relative to the body, by name",
    "inertia": "mass properties; late subscribers receive them too",
    "accel": "of the body origin, body axes, from the equations of motion; with `publish_accel` (log: `--accel`)",
    "pose_with_covariance": "the pose and `pose_covariance`; with `publish_pose_with_covariance`",
    "twist_with_covariance": "the twist and `twist_covariance`; with `publish_twist_with_covariance`",
    "/clock": "simulation time, from the steps; with `publish_clock`",
    "/tf": "the pose; with `publish_tf`, if tf2_msgs is installed (log: always)",
    "/tf_static": "the scene's fixed frames; as `/tf`",
    "/diagnostics": "1 Hz, by a node: state, defects, overruns; commands accepted, rejected, early, late, lost (log "
    "without a node: the warnings of the run, at its end)",
    "~/set_state": "moves the body within the run: pose in the world frame, twist in body axes",
    "wrench": "commands, one topic for each channel of the scene; [what a wrench means](../how-to/wrenches.md)",
    "wrench/applied": "the wrench that acted, and from when",
    "effects/TYPE/applied": "the same for an effect that is held like a wrench",
    "/parameter_events": "by rclpy: every parameter that was set, of any node",
    "/rosout": "by rclpy: the log of the node",
}

SERVICES = {
    "~/pause": "pauses or resumes",
    "~/step": "advances by one output period, while paused or in lockstep; answers when that is done, or why it is not",
    "~/reset": "returns to time 0, initial state, no commands; begins a new log, renames `run.mcap` to `run.1.mcap`",
    "~/set_parameters_atomically": "sets parameters as one change, checked as a whole; `state.*` move the body",
    "~/set_parameters": "sets parameters one after the other: `ros2 param set`",
    "~/get_parameters": "`ros2 param get`",
    "~/get_parameter_types": "types of parameters",
    "~/list_parameters": "`ros2 param list`",
    "~/describe_parameters": "description and range of parameters: `ros2 param describe`",
    "~/get_logger_levels": "levels of the node's log",
    "~/set_logger_levels": "sets them: 10 debug, 20 info, 30 warn, 40 error",
    "~/get_type_description": "by rcl: the definition of a message type",
    "~/change_state": "configure, activate, deactivate, clean up, shut down: `ros2 lifecycle set`",
    "~/get_state": "`ros2 lifecycle get`",
    "~/get_available_states": "all states of a managed node",
    "~/get_available_transitions": "those from the present state: `ros2 lifecycle list`",
    "~/get_transition_graph": "those from every state",
}

METADATA = {
    "rb_dynamics": "method, versions, platform, hashes of the scene and of the code",
    "rb_dynamics.epoch": "ROS time of simulation time 0, if messages were stamped with ROS time; the last one holds",
    "rb_dynamics.topics": "names of the topics after remapping",
    "rb_dynamics.checkpoint": "after each chunk: the number of samples so far, and the SHA-256 of all of them",
    "rb_dynamics.result": "the end of the run: steps, hashes of inputs and of all states (below). In a split bag, "
    "every file but the last has `states_sha256` up to its end and, in `continues_in`, the name of the next file",
}


HASHES = """
    Two runs have the same hash exactly if the hashed data agree to the last bit, on whatever machine they were made.

    - `states_sha256`: {states}
    - `inputs_sha256`: {inputs} `inputs_rule` is 2. A log without it uses rule 1: the hash is over every change of what
      acted, effects and timeouts included, in the order of the log; `replay` checks that too.
    - `scene_sha256`: SHA-256 over the attached scene.
    - `code_sha256`: SHA-256 over the sources that compute runs (folders `body`, `loads`, `motion`, `numerics`, `run`,
      `scene`, `sensors`), each after its path and length: two installations of one version may differ.
"""


def words(hashing: type) -> str:
    """Return the docstring of a hash as one paragraph."""
    text = inspect.cleandoc(hashing.__doc__ or "").partition("Attributes:")[0]
    return " ".join(text.replace("`Sample`", "a sample").split())


def meaning(texts: dict[str, str], name: str) -> str:
    """Return the entry for `name` in one of the tables above.

    Raises:
        SystemExit: There is none; the message says where to add it.
    """
    if name not in texts:
        sys.exit(f"tools/make_reference.py does not describe {name!r}: add a line to the table of {list(texts)[:3]}")
    return texts[name]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [list(head), ["---"] * len(head), *(list(row) for row in rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def problems(tree: dict[str, Any]) -> dict[str, str]:
    """Return the errors that the reader reports for a scene, by key."""
    try:
        rb.parse_scene(yaml.safe_dump(tree, sort_keys=False))
    except SceneError as error:
        found = [re.fullmatch(r"<scene>:\d+: (\S+): (found .*)", line) for line in str(error).splitlines()]
        return {match[1]: match[2] for match in found if match}
    return {}


def place(tree: dict[str, Any], path: str) -> dict[str, Any]:
    """Return the mapping at a dotted path."""
    here: Any = tree
    for part in re.findall(r"[^.\[\]]+", path):
        here = here[int(part) if part.isdigit() else part]
    assert isinstance(here, dict)
    return here


def keys(tree: dict[str, Any], path: str) -> list[str]:
    """Return the keys that the reader accepts at `path`, from its error about an unknown key."""
    probe = copy.deepcopy(tree)
    place(probe, path)[UNKNOWN] = 0
    text = problems(probe)[f"{path}.{UNKNOWN}".lstrip(".")]
    return text.partition("expected one of ")[2].partition(";")[0].split(", ")


def expected(tree: dict[str, Any], path: str, key: str) -> str:
    """Return what the reader expects at a key, from its error about a wrong value."""
    name = f"{path}.{key}".lstrip(".")
    for wrong in ([], {}, "?"):
        probe = copy.deepcopy(tree)
        place(probe, path)[key] = wrong
        text = problems(probe).get(name, "")
        if text:
            words = text.partition(", expected ")[2].rpartition("; ")[0]
            # Leave out methods of plug-ins that happen to be installed.
            for name in set(METHODS) - set(METHODS.own):
                words = re.sub(rf", {re.escape(name)}\b", "", words)
            return re.sub(r"a mapping of .*", "a section, see below", words)
    raise ValueError(f"{name}: the reader accepts anything")


DEFAULTS: dict[str, Callable[[rb.Scene], object]] = {
    "world_frame": lambda scene: scene.frames.world_frame,
    "wrenches": lambda scene: f"[{{topic: {scene.channels[0].topic}}}]",
    "effects": lambda scene: list(scene.effects),
    "actuators": lambda scene: list(scene.actuators),
    "sensors": lambda scene: list(scene.sensors),
    "seed": lambda scene: scene.seed,
    "output_rate": lambda scene: scene.output_rate,
    "body.frame": lambda scene: scene.frames.body_frame,
    "body.center_of_mass": lambda scene: list(scene.body.center_of_mass),
    "wrenches[0].timeout": lambda scene: scene.channels[0].timeout,
    "wrenches[0].optional": lambda scene: str(scene.channels[0].optional).lower(),
    "wrenches[0].delay": lambda scene: scene.channels[0].delay,
    "wrenches[0].on_excess": lambda scene: scene.channels[0].on_excess,
    "solver.method": lambda scene: scene.solver.method,
    "solver.accuracy": lambda scene: scene.solver.accuracy,
}


def needed(tree: dict[str, Any], path: str) -> set[str]:
    """Return the keys that the reader misses at `path`."""
    found = problems(tree).items()
    return {name.removeprefix(f"{path}.") for name, text in found if text.startswith("found nothing")}


def defaults(kind: type) -> dict[str, str]:
    """Return the defaults of an effect, actuator or sensor that are plain values, by key."""
    found = {field.name: field.default for field in fields(kind)}
    plain = {key: value for key, value in found.items() if isinstance(value, (bool, float, str, tuple)) and value != ""}
    texts = {key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}
    return {key: f"`{str(value).lower()}`" for key, value in texts.items() if value != math.inf}


def entries(names: Iterable[str], required: dict[str, str], kind: type) -> str:
    """Return the table of the keys `names`; `required` has those without a default."""
    known = defaults(kind) | required
    return table(
        ("key", "default", "meaning"), [(f"`{key}`", known.get(key, ""), meaning(MEANING, key)) for key in names]
    )


def scene_page() -> str:
    smallest = rb.parse_scene(yaml.safe_dump(SMALLEST))
    parts = [
        "# Scene\n",
        NOTE,
        SCENE,
    ]
    for title, path, tree in SECTIONS:
        rows = []
        for key in keys(tree, path):
            name = f"{path}.{key}".lstrip(".")
            default = f"`{DEFAULTS[name](smallest)}`" if name in DEFAULTS else ""
            rows.append((f"`{key}`", expected(tree, path, key), default, meaning(MEANING, name)))
        heading = title if not path else f"`{title}`"
        parts += [f"## {heading}\n", table(("key", "expected", "default", "meaning"), rows)]
    shapes = [
        (f"`{name}`", ", ".join(f"`{each}`" for each in form.dimensions), "[x, y, z]" if form.vector else "")
        for name, form in SHAPES.items()
    ]
    parts += [
        "## `body.inertia.shape`\n",
        SHAPE,
        table(("type", "lengths", ""), shapes),
        "## `effects[]`\n",
    ]
    for kind in EFFECTS.own:
        tree = SMALLEST | {"effects": [{"type": kind}]}
        names = [key for key in keys(tree, "effects[0]") if key != "type"]
        required = dict.fromkeys(needed(tree, "effects[0]"), "required")
        if kind == "magnetic_field":
            for model in MODELS:
                of_model = SMALLEST | {"effects": [{"type": kind, "model": model}]}
                required |= dict.fromkeys(needed(of_model, "effects[0]"), f"required with `{model}`")
        parts += [
            f"### `{kind}`\n",
            f"{meaning(ACTS, kind)} Example: [{EXAMPLES[kind]}](../../{EXAMPLES[kind]}).\n",
            entries(names, required, EFFECTS[kind]),
        ]
    field = {"type": "magnetic_field", "model": "uniform", "field_world": [0.0, 0.0, 1.0]}
    parts += ["## `actuators[]`\n", "[Add actuators](../how-to/actuators.md) explains them.\n"]
    for kind in ACTUATORS:
        tree = SMALLEST | {"effects": [field], "actuators": [{"type": kind}]}
        names = [key for key in keys(tree, "actuators[0]") if key != "type"]
        required = dict.fromkeys(needed(tree, "actuators[0]"), "required")
        parts += [f"### `{kind}`\n", f"{meaning(DRIVES, kind)}\n", entries(names, required, ACTUATORS[kind])]
    parts += ["## `sensors[]`\n", "[Add sensors](../how-to/sensors.md) explains them.\n"]
    required = dict.fromkeys(needed(SMALLEST | {"sensors": [{"type": "imu"}]}, "sensors[0]"), "required")
    parts.append(entries(COMMON_KEYS, required | {"frame": "the body frame"}, Sensor))
    for kind, sensor in SENSORS.items():
        tree = SMALLEST | {"effects": [field], "sensors": [{"type": kind}]}
        names = [key for key in keys(tree, "sensors[0]") if key not in ("type", *COMMON_KEYS)]
        parts += [
            f"### `{kind}`\n",
            f"{meaning(MEASURES, kind)} Message: {sensor.message.replace('/msg', '')}.\n",
            entries(
                names,
                dict.fromkeys(needed(tree, "sensors[0]"), "required"),
                AxisErrors if set(names) == set(AXIS_KEYS) else sensor,
            ),
        ]
    parts += ["### `gyro` and `accelerometer`\n", entries(AXIS_KEYS, {}, AxisErrors)]
    return "\n".join(parts)


class Recorder(argparse.ArgumentParser):
    """A parser that records the arguments added to it, those in groups included."""

    def __init__(self) -> None:
        self.added: list[argparse.Action] = []
        super().__init__(add_help=False)

    def _add_action(self, action: argparse.Action) -> argparse.Action:
        self.added.append(action)
        return super()._add_action(action)


def cli_page() -> str:
    parts = [
        "# Command line\n",
        NOTE,
        CLI,
    ]
    for name in COMMANDS:
        module = importlib.import_module(f"rb_dynamics.cli.commands.{name}")
        parser = Recorder()
        module.add_arguments(parser)
        rows = []
        for action in parser.added:
            value = action.metavar if action.nargs != 0 else ""
            value = " ".join(value) if isinstance(value, tuple) else value or ""
            label = f"{', '.join(action.option_strings)} {value}".strip() or action.dest
            rows.append((f"`{label}`", (action.help or "") % vars(action)))
        doc = inspect.cleandoc(module.__doc__ or "")
        parts += (
            [f"## {name}\n", doc + "\n", table(("argument", "meaning"), rows)] if rows else [f"## {name}\n", doc + "\n"]
        )
    return "\n".join(parts)


def anywhere(key: str) -> str:
    """Return a key of the metadata without the name of a package, which depends on what is installed."""
    return re.sub(r"^version\..*", "version.*", key)


def log_page() -> str:
    frames = {"thruster": {"position": [0.1, 0.0, 0.0]}}
    scene = rb.read_scene(
        ROOT / "config" / "slew.yaml",
        {"duration": 2.0, "body.frames": frames, "wrenches": [{"topic": "wrench/body"}],
         "effects": [{"type": "uniform_gravity", "acceleration_world": [0.0, 0.0, -9.8]}]},
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        commands = read_wrenches(ROOT / "examples" / "slew.mcap", ["wrench/body"])
        rb.simulate(scene, commands, [McapSink(path, settings=LogSettings(accel=True))])
        bag = read_bag(path)
    rows = []
    for topic in bag.topics.values():
        name = topic.name.replace("wrench/body", "wrench").replace("uniform_gravity", "TYPE")
        known = name if name in TOPICS else name.removeprefix("/")
        rows.append((f"`{known}`", f"`{topic.type_name}`", meaning(TOPICS, known)))
    data = [
        (f"`{name}`", ", ".join(f"`{key}`" for key in dict.fromkeys(map(anywhere, values))), meaning(METADATA, name))
        for name, values in bag.metadata.items()
    ]
    return "\n".join(
        (
            "# Log\n",
            NOTE,
            LOG,
            "## Channels\n",
            table(("channel", "type", "content"), sorted(rows)),
            "With a namespace or remappings the names are those of the node.\n",
            "## Metadata\n",
            table(("record", "keys", "content"), data),
            "A log that had to stop early also has the record `rb_dynamics.interrupted`, with the reason.\n",
            "## Hashes\n",
            inspect.cleandoc(HASHES).format(states=words(StateHash), inputs=words(InputHash)) + "\n",
            "## Attachments\n",
            table(
                ("name", ""),
                [(f"`{name}`", "the scene, meshes and URDF replaced by numbers") for name in bag.attachments],
            ),
        )
    )


def python_page() -> str:
    return "\n".join(("# Python API\n", NOTE, *python_api.page()))


def shown(value: object) -> str:
    """Return a default as written in YAML."""
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"`{text}`" if text else ""


def ros_page() -> str:
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from rb_dynamics.ros import settings
    from rb_dynamics.ros.lifecycle import LifecycleBody
    from rb_dynamics.ros.node import RigidBodyNode

    gravity = {"type": "uniform_gravity", "acceleration_world": [0.0, 0.0, -9.8]}
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as scene:
        yaml.safe_dump(SMALLEST | {"effects": [gravity]}, scene)
        scene.flush()
        topics = ("clock", "accel", "pose_with_covariance", "twist_with_covariance")
        asked = [f"scene:={scene.name}", "start_paused:=true", *(f"publish_{topic}:=true" for topic in topics)]
        arguments = [word for each in asked for word in ("-p", each)]
        rclpy.init(args=["--ros-args", *arguments], signal_handler_options=SignalHandlerOptions.NO)
        try:
            node = RigidBodyNode()
            outward = {p.topic_name: p for p in node.publishers}
            inward = {s.topic_name: s for s in node.subscriptions}
            services = {s.srv_name: s.srv_type for s in node.services}
            node.destroy_node()
            managed = LifecycleBody()
            offered = {f"~/{s.srv_name.rpartition('/')[2]}": s.srv_type for s in managed.services}
            managed.destroy_node()
        finally:
            rclpy.try_shutdown()

    def type_name(kind: type) -> str:
        package, _, rest = kind.__module__.partition(".")
        return f"`{package}/{rest.partition('.')[0]}/{kind.__name__}`"

    def short(name: str) -> str:
        name = f"/{name.removeprefix('/')}".replace("/rigid_body/", "~/")
        return name if name in TOPICS or name in SERVICES else name.removeprefix("/")

    def row(name: str, direction: str, end: Any) -> tuple[str, ...]:
        durability = end.qos_profile.durability.name.lower().replace("_", " ")
        return (f"`{short(name)}`", direction, type_name(end.msg_type), durability, meaning(TOPICS, short(name)))

    rows = [row(name, "in", end) for name, end in sorted(inward.items())]
    rows += [row(name, "out", end) for name, end in sorted(outward.items())]
    if "/tf" not in outward:
        tf = "`tf2_msgs/msg/TFMessage`"
        rows += [("`/tf`", "out", tf, "volatile", meaning(TOPICS, "/tf"))]
        rows += [("`/tf_static`", "out", tf, "transient local", meaning(TOPICS, "/tf_static"))]
    rows.append(("`/rosout`", "out", "`rcl_interfaces/msg/Log`", "transient local", meaning(TOPICS, "/rosout")))
    listed = [each for each in rows if each[-1]]
    parameters = [(f"`{name}`", shown(value), text) for name, value, text in settings.documented()]
    own = {short(name): type_name(kind) for name, kind in sorted(services.items())}
    managing = {name: type_name(kind) for name, kind in sorted(offered.items()) if name not in own}

    def served(services: dict[str, str]) -> str:
        rows = [(f"`{name}`", kind, meaning(SERVICES, name)) for name, kind in services.items()]
        return table(("service", "type", "effect"), rows)

    return "\n".join(
        (
            "# Topics, parameters and services\n",
            NOTE,
            NODE,
            "## Topics\n",
            table(("topic", "direction", "type", "durability", "content"), listed),
            OF_SCENE,
            "## Parameters\n",
            table(("parameter", "default", "meaning"), parameters),
            PARAMETERS,
            "## Services\n",
            served(own),
            "If [simulation_interfaces](../ros.md#simulation_interfaces) is installed, the node has its services.\n",
            "## Managed node\n",
            MANAGED,
            served(managing),
        )
    )  # fmt: skip


PAGES: dict[str, Callable[[], str]] = {
    "scene.md": scene_page,
    "cli.md": cli_page,
    "ros.md": ros_page,
    "log.md": log_page,
    "python.md": python_page,
}


def main(arguments: list[str]) -> int:
    """Write the pages, or print which are out of date; return the exit code, 1 if one is."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    stale = 0
    for name, make in PAGES.items():
        if make is ros_page and find_spec("rclpy") is None:
            print(f"docs/reference/{name}: not written, as rclpy is not installed")
            continue
        text, path = make(), FOLDER / name
        if "--check" not in arguments:
            FOLDER.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
            continue
        found = path.read_text(encoding="utf-8") if path.exists() else ""
        if found != text:
            stale = 1
            print(f"docs/reference/{name} is out of date; run `python tools/make_reference.py`")
            print("\n".join(list(difflib.unified_diff(found.splitlines(), text.splitlines(), lineterm="", n=0))[:20]))
    return stale


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
