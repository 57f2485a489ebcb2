"""Read a scene file: YAML to a validated `Scene`. Keys, defaults and limits are defined here and in `read_*.py`.

Nothing is guessed: an error names file, line, key, value, what was expected and the remedy.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from rb_dynamics.errors import PluginError, SceneError
from rb_dynamics.formats.yaml import document
from rb_dynamics.formats.yaml.fields import Field, Rule, Section
from rb_dynamics.formats.yaml.problems import Problems
from rb_dynamics.formats.yaml.text_file import read_text
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.numerics.argument_checks import instance, shown
from rb_dynamics.numerics.nanoseconds import LONGEST, NANOSECONDS, SHORTEST
from rb_dynamics.scene.model import DEFAULT_ACCURACY, MOST_SEED, Scene, Solver
from rb_dynamics.scene.overrides import apply_overrides
from rb_dynamics.scene.read_body import body_and_frames
from rb_dynamics.scene.read_devices import devices
from rb_dynamics.scene.read_effects import effects
from rb_dynamics.scene.read_state import INITIAL_KEYS, initial_state, past
from rb_dynamics.scene.read_wrench_channels import channels
from rb_dynamics.scene.shipped import shipped

_NO_OVERRIDES: Mapping[str, object] = MappingProxyType({})

ROOT_KEYS = (
    "world_frame", "body", "initial", "wrenches", "effects", "actuators", "sensors", "seed", "solver", "duration",
    "output_rate", "continues",
)  # fmt: skip
"""The keys of a scene, with which dotted parameters of the node begin."""

_NESTED_KEYS = (
    "body.mass", "body.center_of_mass", "body.inertia", "body.frames", "initial.position_world", "initial.orientation",
    "initial.linear_velocity_world", "initial.linear_velocity_body", "initial.angular_velocity_body", "solver.method",
    "solver.accuracy", "solver.step",
)  # fmt: skip

_STEP = Rule(
    f"a number from {SHORTEST:g} to {LONGEST:.1e} (s)",
    lambda v: SHORTEST <= v <= LONGEST,
    "time is counted in nanoseconds, write a step such as 0.001",
)
_ACCURACY = Rule(
    "a number greater than 0 and less than 1",
    lambda v: 0.0 < v < 1.0,
    "write the error accepted at the end of the run, such as 1.0e-9",
)
_DURATION = Rule(
    f"a number from {SHORTEST:g} to {LONGEST:.1e} (s)",
    lambda v: SHORTEST <= v <= LONGEST,
    "time is counted in 64-bit nanoseconds, write the seconds to simulate or remove the key",
)
_SEED = Rule(
    f"a whole number from 0 to {MOST_SEED:d}",
    lambda v: 0.0 <= v <= MOST_SEED and v == int(v),
    "write any, such as 1: the same gives the same noise",
)
_OUTPUT_RATE = Rule(
    f"0 (every step) or a number from {1.0 / LONGEST:.1e} to {NANOSECONDS:g} (Hz)",
    lambda v: v == 0.0 or 1.0 / LONGEST <= v <= NANOSECONDS,
    "write how many states per second to publish and log, such as 100",
)


UNSAID = "# This scene was made or changed in Python: no text says what it is.\n"
"""Text of a scene in a log, if no text reproduces it."""


def opened(scene: Scene | str | os.PathLike[str]) -> Scene:
    """Return `scene`, read if it is the path of a file.

    Raises:
        TypeError: it is neither.
        SceneError: the file cannot be read, or is not a valid scene.
    """
    if isinstance(scene, (str, os.PathLike)):
        return read_scene(scene)
    return instance(scene, Scene, "scene", "give one, or the path of its file")


def read_scene(path: str | os.PathLike[str], overrides: Mapping[str, object] = _NO_OVERRIDES) -> Scene:
    """Return the scene in the YAML file `path`, with the dotted keys in `overrides` replaced.

    A name without a folder that is not a file here, such as "slew.yaml", is looked up among the scenes of the package.

    Raises:
        SceneError: the file cannot be read, or is not a valid scene; one line for each problem.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path is {shown(path)}, expected the path of a scene file; write a str or a Path")
    source = os.fspath(path)
    if os.path.basename(source) == source.strip() != "" and not os.path.lexists(source):
        with contextlib.suppress(SceneError):
            source = str(shipped(f"config/{source}"))
    return parse_scene(read_text(source, "scene"), source, overrides)


def parse_scene(text: str, source: str = "<scene>", overrides: Mapping[str, object] = _NO_OVERRIDES) -> Scene:
    """Return the scene in the YAML `text`, with the dotted keys in `overrides` replaced.

    >>> scene = parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}", overrides={"duration": 10.0})
    >>> scene.body.principal_moments, scene.duration
    ((1.0, 2.0, 3.0), 10.0)

    Raises:
        SceneError: `text` is not a valid scene; one line for each problem, headed by `source` and its line.
    """
    instance(text, str, "text", "give the scene as YAML; a file is read with read_scene(path)")
    problems = Problems(instance(source, str, "source", "name the text; write overrides={...} to replace keys"))
    tree = document.parse(text, problems)
    if document.holds(tree, ("scene", "runs"), "body"):
        raise SceneError(
            f"{source}: found a campaign, expected a scene; run it with rb-dynamics campaign {source}, or give the "
            "scene that it names"
        )
    apply_overrides(tree, overrides, problems)
    changes = [f"overrides of {', '.join(overrides)}"] if overrides else []
    return scene_of(tree, problems, text, changes)


def scene_of(tree: document.Node, problems: Problems, text: str, changes: Sequence[str] = ()) -> Scene:
    """Return the scene in `tree`, which may be changed; `problems` are those already found in it.

    `text` is the source of `tree`; after `changes`, or if a file defines the body, the scene's text is generated.

    Raises:
        SceneError: it is not a valid scene; one line for each problem.
    """
    root = Field(tree, "", problems).section(ROOT_KEYS, _NESTED_KEYS)
    reading, frames = body_and_frames(root)
    initial = initial_state(root.section("initial", INITIAL_KEYS), reading.body)
    taken: dict[str, str] = {}
    wrenches = channels(root.get("wrenches"), taken)
    acting = effects(root.get("effects"), reading.body, frames)
    driving, measuring = devices(root, reading.body, frames, acting, taken)
    seed = root.whole("seed", _SEED, 0)
    solver = _solver(root.section("solver", ("method", "accuracy", "step")))
    duration = root.get("duration")
    seconds = None if duration is None else duration.number(_DURATION, 1.0)
    output_rate = root.number("output_rate", _OUTPUT_RATE, 100.0)
    before = past(root.get("continues"), reading.body)
    if reading.body is None or problems:
        raise problems.error()
    changes = [*changes, f"the body that {reading.file} says"] if reading.file else changes
    if changes:
        text = document.to_text(tree, f"{problems.source} with {' and '.join(changes)}")
    return Scene(
        reading.body,
        frames,
        initial,
        wrenches,
        solver,
        seconds,
        output_rate,
        text,
        problems.source,
        effects=acting,
        sensors=measuring,
        actuators=driving,
        seed=seed,
        past=before,
        findings=reading.findings,
        surface=reading.surface,
    )


def rest_is_independent(scene: Scene) -> bool:
    """Return whether all but frames, initial state and seed is read alike for every body with inertia."""
    from rb_dynamics.sensors.sensor_types import SENSORS

    kinds = {type(each) for each in (*scene.effects, *scene.actuators, *scene.sensors)}
    known = {UniformGravity, CentralGravity, ReactionWheel, *SENSORS.values()}
    return kinds <= known and scene.past is None and not scene.body.is_particle


def with_true_text(scene: Scene) -> Scene:
    """Return `scene` with a text that describes it, if its own does not, as after `replace`.

    Otherwise a log would contain, and `replay` would run, another scene.
    """
    try:
        if parse_scene(scene.text, scene.source) == scene:
            return scene
    except SceneError:
        pass
    return replace(scene, text=UNSAID)


def _solver(section: Section) -> Solver:
    method = _method(section.get("method"))
    step, accuracy = section.get("step"), section.get("accuracy")
    if step is None:
        return Solver(method, None, section.number("accuracy", _ACCURACY, DEFAULT_ACCURACY))
    if accuracy is not None:
        accuracy.number(_ACCURACY, DEFAULT_ACCURACY)
        section.field.reject("one of step and accuracy", "remove the other", "both step and accuracy")
    return Solver(method, step.number(_STEP, 1.0), None)


def _method(field: Field | None) -> str:
    from rb_dynamics.motion import METHODS, remedy

    if field is None:
        return "auto"
    name = field.node.value if isinstance(field.node.value, str) else ""
    try:
        if name == "auto" or (METHODS.get(name)):
            return name
    except PluginError as error:
        field.reject("a method that can be loaded", str(error))
        return "auto"
    known = ("auto", *METHODS)
    mend = remedy(name, known, "write auto to let the method be chosen")
    return field.text(f"one of {', '.join(known)}", lambda _: False, mend, "auto")
