"""Read the `body` section of a scene: its frames; `read_inertia.py` reads mass, centre of mass and inertia."""

from __future__ import annotations

import re

from rb_dynamics.formats.yaml.fields import Field, Section
from rb_dynamics.formats.yaml.problems import printable
from rb_dynamics.loads.wrench import FixedFrame, WrenchFrames
from rb_dynamics.scene.read_inertia import LENGTH, BodyReading, read_inertia


def body_and_frames(root: Section) -> tuple[BodyReading, WrenchFrames]:
    """Return the body, and the names of the world, body and fixed frames."""
    if root.get("body") is None:
        root.missing("body", "a section with mass and inertia", "add body: {mass: 1.0, inertia: {diagonal: [1, 1, 1]}}")
        return BodyReading(None), WrenchFrames()
    section = root.section("body", ("frame", "mass", "center_of_mass", "inertia", "frames"))
    world = _frame_name(root.get("world_frame"), "world")
    frame = _frame_name(section.get("frame"), "body")
    named = section.get("frame") or root.get("world_frame")
    if world == frame and named is not None:
        named.reject("different names for world_frame and body.frame", "rename one of them")
    fixed = _fixed_frames(section.get("frames"), (world, frame))
    reading = read_inertia(section)
    frames = WrenchFrames(world, frame, fixed) if world != frame else WrenchFrames()
    return reading, frames.of(reading.body) if reading.body else frames


def _frame_name(field: Field | None, default: str) -> str:
    if field is None:
        return default
    return field.text(
        "the name of a frame", _is_frame_name, "use letters, digits and _, without spaces and leading /", default
    )


def _is_frame_name(name: str) -> bool:
    return re.fullmatch(r"[^\s/]\S*", name) is not None and name.isprintable()


def _fixed_frames(field: Field | None, taken: tuple[str, str]) -> dict[str, FixedFrame]:
    frames = {}
    for name, frame in field.mapping("{position:, orientation:}").items() if field else ():
        if name in taken:
            frame.reject("a name that is neither the world's nor the body's", "rename the frame", f"the name {name}")
            continue
        if not _is_frame_name(name):
            frame.reject("the name of a frame", "use letters, digits and _", f"the name '{printable(name)}'")
            continue
        values = frame.section(("position", "orientation"))
        frames[name] = FixedFrame(values.vector("position", LENGTH), values.quaternion("orientation"))
    return frames
