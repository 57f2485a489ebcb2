"""Every kind of invalid scene, and its error message."""

from __future__ import annotations

import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.formats.yaml.problems import MAX_REPORTED
from rb_dynamics.scene.read import parse_scene

# Four lines that are a valid scene; what a case adds begins on line 5.
BODY = """\
body:
  mass: 16.8
  inertia:
    diagonal: [1, 2, 3]
"""


def error_of(text: str, **overrides: object) -> str:
    with pytest.raises(SceneError) as caught:
        parse_scene(text, "s.yaml", overrides)
    return str(caught.value)


def after(text: str) -> str:
    return f"{BODY}{text}\n"


def inertia(text: str) -> str:
    return f"body:\n  mass: 1\n  inertia:\n    {text}\n"


def massless(text: str) -> str:
    return f"body:\n  inertia:\n    {text}\n"


def mass(text: str) -> str:
    return f"body:\n  mass: {text}\n  inertia: {{diagonal: [1, 2, 3]}}\n"


CASES = {
    # The document
    "empty": ("", ["s.yaml: ", "empty", "the key body"]),
    "only a comment": ("# nothing\n", ["empty"]),
    "no mapping": ("- 1\n- 2\n", ["s.yaml:1: ", "[1, 2]", "mapping"]),
    "plain text": ("hello", ["s.yaml:1: ", "hello", "mapping"]),
    "two documents": (after("---\na: 1"), ["s.yaml:5: ", "single document"]),
    "no space after a colon": (
        "body:\n  mass:1\n  inertia: 2\n",
        ["s.yaml:3: found no valid YAML (", "colons of this"],
    ),
    "open bracket": ("body:\n  a: [1, 2\n  b: 1\n", ["s.yaml:3: found no valid YAML (while", "correct this line"]),
    "tab": ("body:\n\tmass: 1\n", ["s.yaml:2: ", "spaces, not with tabs"]),
    "undefined alias": ("body: *b\n", ["s.yaml:1: ", "undefined alias 'b'"]),
    "bad escape": ('body: "\\UFFFFFFFF"\n', ["s.yaml: ", "escapes"]),
    "control character": ("body:\n  a: \x07\n", ["s.yaml:2: ", "'\\x07'", "UTF-8"]),
    "python tag": (mass("!!python/object/apply:os.getcwd []"), ["s.yaml:2: ", "python/object/apply", "remove the tag"]),
    "harmless tag": (mass("!!float 1"), ["s.yaml:2: ", "remove the tag"]),
    "merge key": (after("  <<: {frame: a}"), ["s.yaml:5: body: ", "write the keys out"]),
    "key is a list": ("[1, 2]: 3\n" + BODY, ["s.yaml:1: ", "no plain name"]),
    "duplicate key": (after("duration: 1\nbody: 2"), ["s.yaml:6: body: found again, first on line 1"]),
    "duplicate nested key": (after("  mass: 2"), ["s.yaml:5: body.mass: found again, first on line 2"]),
    "duplicate key in a list": (after("wrenches:\n- topic: a\n  topic: b"), ["s.yaml:7: wrenches[0].topic: found ag"]),
    # Unknown and missing keys
    "unknown key": (after("durration: 60"), ["s.yaml:5: durration: ", "unknown key", "did you mean duration?"]),
    "unknown nested key": (after("  masss: 2"), ["s.yaml:5: body.masss: ", "did you mean mass?"]),
    "misspelt section": ("bodi:\n  mass: 1\n", ["s.yaml:1: bodi: found an unknown key", "did you mean body?"]),
    "unknown key far from all": (after("zzz: 1"), ["s.yaml:5: zzz: ", "expected one of world_frame, ", "remove it"]),
    "empty key": (after("'': 1"), ["s.yaml:5: '': found an unknown key"]),
    "unknown key of a channel": (after("wrenches: [{topic: a, tiemout: 1}]"), ["wrenches[0].tiemout", "n timeout?"]),
    "no body": ("duration: 1\n", ["s.yaml:1: body: found nothing", "mass"]),
    "body is a number": ("body: 5\n", ["s.yaml:1: body: found 5", "mapping of frame, mass"]),
    "body is empty": ("body:\nduration: 1\n", ["s.yaml:1: body: found nothing", "mapping of frame, mass"]),
    "no mass": (
        "duration: 1\nbody:\n  inertia: {diagonal: [1, 2, 3]}\n",
        ["s.yaml:2: body.mass: found nothing", "(kg)"],
    ),
    "no inertia": (
        "body:\n  mass: 1\n  inertial: {diagonal: [1, 2, 3]}\n",
        ["s.yaml:3: body.inertial: found an unknown key", "did you mean inertia?"],
    ),
    # Numbers
    "negative mass": (
        mass("-16.8"),
        ["s.yaml:2: body.mass: found -16.8, expected a number greater than 0 (kg); write"],
    ),
    "zero mass": (mass("0"), ["s.yaml:2: body.mass: found 0, expected a number greater than 0"]),
    "mass that underflows": (mass("1e-400"), ["body.mass: found 1e-400", "greater than 0"]),
    "mass true": (mass("true"), ["s.yaml:2: body.mass: found true", "not numbers"]),
    "mass yes": (mass("yes"), ["body.mass: found yes", "yes, no, on, off"]),
    "mass off": (mass("off"), ["body.mass: found off", "yes, no, on, off"]),
    "mass NaN": (mass("NaN"), ["body.mass: found NaN", "NaN are not accepted"]),
    "mass .nan": (mass(".nan"), ["body.mass: found .nan", "NaN are not accepted"]),
    "mass .inf": (mass(".inf"), ["body.mass: found .inf", "infinities"]),
    "mass -.INF": (mass("-.INF"), ["body.mass: found -.INF", "infinities"]),
    "mass Infinity": (mass("Infinity"), ["body.mass: found Infinity", "infinities"]),
    "mass too large": (mass("1e999"), ["body.mass: found 1e999", "infinities"]),
    "mass with unit": (mass("16.8 kg"), ["body.mass: found 16.8 kg", "without a unit"]),
    "mass in quotes": (mass("'16.8'"), ["body.mass: found '16.8'", "remove the quotes"]),
    "mass octal": (mass("010"), ["body.mass: found 010", "plain decimals"]),
    "mass hexadecimal": (mass("0x10"), ["body.mass: found 0x10", "plain decimals"]),
    "mass sexagesimal": (mass("1:30"), ["body.mass: found 1:30", "plain decimals"]),
    "mass with underscore": (mass("1_000"), ["body.mass: found 1_000", "plain decimals"]),
    "mass a list": (mass("[1]"), ["body.mass: found [1]", "single number"]),
    "mass a mapping": (mass("{a: 1}"), ["body.mass: found {a: 1}", "single number"]),
    "mass nothing": (mass(""), ["s.yaml:2: body.mass: found nothing", "give the key a value"]),
    "mass null": (mass("null"), ["body.mass: found nothing"]),
    "found is cut": (mass("x" * 5000), ["found xxxxx", "x..., expected"]),
    "found is printable": (mass('"a\\nb\\e[31m"'), ["\\n", "\\x1b[31m"]),
    # Vectors
    "vector too short": (
        after("  center_of_mass: [0, 0]"),
        ["s.yaml:5: body.center_of_mass: found [0, 0]", "3 numbers"],
    ),
    "vector a number": (after("  center_of_mass: 0"), ["s.yaml:5: body.center_of_mass: found 0", "[x, y, z]"]),
    "vector a mapping": (after("  center_of_mass: {x: 1}"), ["s.yaml:5: body.center_of_mass: found {x: 1}"]),
    "vector with NaN": (
        after("  center_of_mass:\n  - 0\n  - .nan\n  - 0"),
        ["s.yaml:7: body.center_of_mass[1]: found .n"],
    ),
    "vector with bool": (
        after("initial: {position_world: [0, on, 0]}"),
        ["s.yaml:5: initial.position_world[1]: found on"],
    ),
    "vector with null": (after("initial: {linear_velocity_world: [0, , 0]}"), ["s.yaml:5: "]),
    "rate with text": (
        after("initial: {angular_velocity_body: [a, 0, 0]}"),
        ["initial.angular_velocity_body[0]", "rad/s"],
    ),
    "initial is a list": (after("initial: []"), ["s.yaml:5: initial: found []", "mapping of position_world"]),
    "initial is empty": (after("initial:"), ["s.yaml:5: initial: found nothing", "remove the key"]),
    "initial in other axes": (
        after("initial: {angular_velocity_world: [0, 0, 0]}"),
        ["did you mean angular_velocity_body?"],
    ),
    # Inertia
    "inertia a list of moments": (
        inertia("[1, 2, 3]"),
        ["s.yaml:4: body.inertia: found [1, 2, 3]", "name the form: {diagonal: [1, 2, 3]}"],
    ),
    "inertia a bare matrix": (inertia("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]"), ["name the form: {matrix: [[1, 0, 0], "]),
    "inertia as in a URDF": (
        inertia("{ixx: 1, iyy: 2, izz: 3}"),
        ["body.inertia: found {ixx: 1, ", "write matrix: [["],
    ),
    "a key of a section": (after("mass: 2"), ["mass: found an unknown key", "did you mean body.mass?"]),
    "nearly one": (after("angular_velocity: [1, 2, 3]"), ["did you mean initial.angular_velocity_body?"]),
    "inertia a list": (
        inertia("[1, 2, 3]"),
        ["s.yaml:4: body.inertia: found [1, 2, 3]", "matrix, diagonal, principal"],
    ),
    "inertia empty": (
        inertia("{}"),
        ["s.yaml:4: body.inertia: found {}", "exactly one of matrix, diagonal, principal"],
    ),
    "inertia two ways": (
        inertia("diagonal: [1, 2, 3]\n    matrix: [[1, 0, 0], [0, 2, 0], [0, 0, 3]]"),
        ["s.yaml:4: body.inertia: found matrix and diagonal", "exactly one", "remove all but one"],
    ),
    "inertia misspelt": (inertia("digonal: [1, 2, 3]"), ["s.yaml:4: body.inertia.digonal: ", "did you mean diagonal?"]),
    # Inertia from particles
    "particles and mass": (
        inertia("particles: [{mass: 1, position: [1, 0, 0]}]"),
        ["s.yaml:2: body.mass: found body.mass, expected no mass and no center_of_mass beside inertia.particles"],
    ),
    "particles, mass and centre": (
        "body:\n  mass: 1\n  center_of_mass: [0, 0, 0]\n  inertia: {particles: [{mass: 1, position: [1, 0, 0]}]}\n",
        ["s.yaml:2: body.mass: found body.mass and body.center_of_mass", "follow from the particles", "remove body.m"],
    ),
    "particles a mapping": (massless("particles: {mass: 1}"), ["body.inertia.particles: found {mass: 1}", "a list"]),
    "particles empty": (
        massless("particles: []"),
        ["s.yaml:3: body.inertia.particles: ", "no particles", "at least 3"],
    ),
    "particle without mass": (
        massless("particles:\n    - {position: [1, 0, 0]}"),
        ["s.yaml:4: body.inertia.particles[0].mass: found nothing", "(kg)"],
    ),
    "particle without position": (
        massless("particles: [{mass: 1}]"),
        ["s.yaml:3: body.inertia.particles[0].position: found nothing", "add position: [x, y, z]"],
    ),
    "particle misspelt": (
        massless("particles: [{mass: 1, pos: [1, 0, 0]}]"),
        ["body.inertia.particles[0].pos: ", "did you mean position?"],
    ),
    "particle without weight": (
        massless("particles: [{mass: 0, position: [1, 0, 0]}]"),
        ["body.inertia.particles[0].mass: found 0"],
    ),
    "particles on a line": (
        massless("particles: [{mass: 1, position: [0.1, 0.2, 0.3]}, {mass: 2, position: [0.3, 0.6, 0.9]}]"),
        ["s.yaml:3: body.inertia.particles: ", "on one line", "expected at least 3", "type: rod"],
    ),
    # Inertia from a shape
    "shape a name": (inertia("shape: box"), ["s.yaml:4: body.inertia.shape: found box", "write {type: box, size"]),
    "shape without type": (inertia("shape: {size: [1, 2, 3]}"), ["body.inertia.shape.type: found nothing", "box, sp"]),
    "shape unknown": (
        inertia("shape: {type: cilinder, radius: 1, length: 2}"),
        ["body.inertia.shape.type: found cilinder, expected one of box, ", "did you mean cylinder?"],
    ),
    "shape far from all": (inertia("shape: {type: banana}"), ["body.inertia.shape.type: found banana", "give a mesh"]),
    "shape type a list": (inertia("shape: {type: [box]}"), ["body.inertia.shape.type: found [box]"]),
    "shape with another's key": (
        inertia("shape: {type: sphere, size: [1, 2, 3], radius: 1}"),
        ["body.inertia.shape.size: found an unknown key", "type, radius, density, orientation"],
    ),
    "box without size": (inertia("shape: {type: box}"), ["body.inertia.shape.size: found nothing", "add size: [x, y"]),
    "box flat": (inertia("shape: {type: box, size: [1, 0, 1]}"), ["body.inertia.shape.size[1]: found 0", "greater th"]),
    "rod without radius": (
        inertia("shape: {type: rod, length: 1}"),
        ["body.inertia.shape.radius: found nothing", "a rod without thickness has no moment about its own axis"],
    ),
    "hollow inside out": (
        inertia("shape: {type: hollow_sphere, outer_radius: 1, inner_radius: 2}"),
        ["s.yaml:4: body.inertia.shape: ", "inner_radius is 2.0", "exchange them"],
    ),
    "shape with mass and density": (
        inertia("shape: {type: sphere, radius: 1, density: 2}"),
        ["s.yaml:4: body.inertia.shape.density: found a density beside body.mass", "remove one of them"],
    ),
    "shape without mass": (
        massless("shape: {type: sphere, radius: 1}"),
        ["s.yaml:1: body.mass: found nothing", "or a density in body.inertia.shape"],
    ),
    "shell with density": (
        massless("shape: {type: spherical_shell, radius: 1, density: 1000}"),
        ["s.yaml:3: body.inertia.shape: ", "a thin shell has no volume", "give body.mass"],
    ),
    "density negative": (
        massless("shape: {type: sphere, radius: 1, density: -1}"),
        ["body.inertia.shape.density: found -1, expected a number greater than 0 (kg/m^3)"],
    ),
    "shape beyond numbers": (
        massless("shape: {type: sphere, radius: 1e200, density: 1}"),
        ["s.yaml:3: body.inertia.shape: ", "expected"],
    ),
    # Inertia from files
    "mesh a name": (massless("mesh: a.stl"), ["s.yaml:3: body.inertia.mesh: found a.stl", "mapping of file, density"]),
    "mesh without file": (massless("mesh: {density: 1}"), ["body.inertia.mesh.file: found nothing", "relative to the"]),
    "mesh without density": (
        massless("mesh: {file: a.stl}"),
        ["s.yaml:1: body.mass: found nothing", "or a density in body.inertia.mesh"],
    ),
    "mesh and centre of mass": (
        "body:\n  center_of_mass: [0, 0, 0]\n  inertia: {mesh: {file: a.stl, density: 1}}\n",
        ["s.yaml:2: body.center_of_mass: ", "beside inertia.mesh", "remove body.center_of_mass"],
    ),
    "mesh that is not there": (
        massless("mesh: {file: no-such.stl, density: 1}"),
        ["s.yaml:3: body.inertia.mesh: ", "no-such.stl cannot be read (No such file", "check the path"],
    ),
    "mesh of another format": (massless("mesh: {file: a.step, density: 1}"), ["body.inertia.mesh: ", "convert the m"]),
    "mesh by URL": (
        massless("mesh: {file: 'https://a.org/a.stl', density: 1}"),
        ["s.yaml:3: body.inertia.mesh.file: found 'https://a.org/a.stl'", "are not followed"],
    ),
    "mesh by package": (massless("urdf: {file: package://a/a.urdf, link: b}"), ["inertia.urdf.file: ", "not followed"]),
    "mesh with a line break": (massless('mesh: {file: "a\\nb.stl", density: 1}'), ["body.inertia.mesh.file: found "]),
    "mesh scale zero": (massless("mesh: {file: a.stl, density: 1, scale: 0}"), ["mesh.scale: found 0", "0.001"]),
    "URDF without link": (massless("urdf: {file: a.urdf}"), ["body.inertia.urdf.link: found nothing"]),
    "URDF and mass": (
        inertia("urdf: {file: a.urdf, link: b}"),
        ["s.yaml:2: body.mass: found body.mass, expected no mass and no center_of_mass beside inertia.urdf"],
    ),
    "URDF that is not there": (massless("urdf: {file: a.urdf, link: b}"), ["body.inertia.urdf: ", "check the path"]),
    "row-major slip": (
        inertia("matrix: [[2.0, 1.8, 2.4], [1.8, 0.02, -0.03], [2.4, -0.03, 0.01]]"),
        ["s.yaml:4: body.inertia.matrix: ", "in the order Ixx Iyy Izz Ixy Ixz Iyz it would be valid"],
    ),
    "matrix flat": (inertia("matrix: [1, 0, 0, 0, 2, 0, 0, 0, 3]"), ["s.yaml:4: body.inertia.matrix: found 9 values"]),
    "matrix a number": (inertia("matrix: 1"), ["s.yaml:4: body.inertia.matrix: found 1, ", "3 rows of 3"]),
    "matrix short row": (
        inertia("matrix:\n    - [1, 0, 0]\n    - [0, 2]\n    - [0, 0, 3]"),
        ["s.yaml:6: body.inertia.matrix[1]: found [0, 2]", "3 numbers"],
    ),
    "matrix with infinity": (
        inertia("matrix: [[1, 0, 0], [0, 2, 0], [0, 0, .inf]]"),
        ["body.inertia.matrix[2][2]: found .inf"],
    ),
    "matrix asymmetric": (
        inertia("matrix: [[1, 0.1, 0], [0.2, 1, 0], [0, 0, 1]]"),
        ["s.yaml:4: body.inertia.matrix: ", "not symmetric", "0.1", "0.2"],
    ),
    "matrix indefinite": (
        inertia("matrix: [[1, 2, 0], [2, 1, 0], [0, 0, 1]]"),
        ["s.yaml:4: body.inertia.matrix: ", "-1.0", "greater than 0"],
    ),
    "matrix breaks the triangle": (
        inertia("matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 3]]"),
        ["s.yaml:4: body.inertia.matrix: ", "1 + 1 < 3", "sum of the other two"],
    ),
    "products of wrong sign": (
        # Moments 2.8, 0.7, 0.7; with the products negated 0, 2.1, 2.1, which a rod has.
        inertia("matrix: [[1.4, 0.69, 0.69], [0.69, 1.4, 0.69], [0.69, 0.69, 1.4]]"),
        ["s.yaml:4: body.inertia.matrix: ", "wrong sign"],
    ),
    "diagonal breaks the triangle": (
        inertia("diagonal: [1, 2, 3.1]"),
        ["s.yaml:4: body.inertia.diagonal: ", "1 + 2 < 3.1"],
    ),
    "diagonal negative": (
        inertia("diagonal: [1, -2, 3]"),
        ["s.yaml:4: body.inertia.diagonal: ", "-2.0", "greater than 0"],
    ),
    "diagonal zero": (inertia("diagonal: [0, 1, 1]"), ["s.yaml:4: body.inertia.diagonal: ", "greater than 0"]),
    "principal without moments": (
        inertia("principal: {}"),
        ["s.yaml:4: body.inertia.principal.moments: found nothing"],
    ),
    "principal a list": (
        inertia("principal: [1, 2, 3]"),
        ["s.yaml:4: body.inertia.principal: found [1, 2, 3]", "moments"],
    ),
    "principal impossible": (inertia("principal: {moments: [1, 1, 9]}"), ["body.inertia.principal: ", "1 + 1 < 9"]),
    "principal not unit": (
        inertia("principal: {moments: [1, 1, 1], orientation: {x: 1, y: 1, z: 0, w: 0}}"),
        ["s.yaml:4: body.inertia.principal.orientation: found norm 1.414"],
    ),
    # Quaternions
    "quaternion a list": (
        after("initial: {orientation: [0, 0, 0, 1]}"),
        ["s.yaml:5: initial.orientation: found [0, 0, 0, 1], expected {x:, y:, z:, w:}"],
    ),
    "quaternion not unit": (
        after("initial:\n  orientation: {x: 0, y: 0, z: 0, w: 1.0011}"),
        ["s.yaml:6: initial.orientation: found norm 1.0011", "divide each component by the norm"],
    ),
    "quaternion zero": (
        after("initial: {orientation: {x: 0, y: 0, z: 0, w: 0}}"),
        ["found norm 0.0 of {x: 0, y: 0, z: 0, w: 0}"],
    ),
    "quaternion incomplete": (
        after("initial: {orientation: {x: 0, y: 0, z: 0}}"),
        ["s.yaml:5: initial.orientation.w: found n"],
    ),
    "quaternion with NaN": (
        after("initial: {orientation: {x: .nan, y: 0, z: 0, w: 1}}"),
        ["initial.orientation.x: found .nan"],
    ),
    "quaternion a number": (
        after("initial: {orientation: 1}"),
        ["initial.orientation: found 1", "mapping of x, y, z, w"],
    ),
    "quaternion in ROS 1 names": (
        after("initial: {orientation: {qx: 0, y: 0, z: 0, w: 1}}"),
        ["orientation.qx: ", "did you mean x?"],
    ),
    # Frames
    "same frames": (
        "world_frame: base\n" + after("  frame: base"),
        ["s.yaml:6: body.frame: found base", "different names"],
    ),
    "same frames by default": ("world_frame: body\n" + BODY, ["s.yaml:1: world_frame: found body", "different names"]),
    "frame a number": ("world_frame: 5\n" + BODY, ["s.yaml:1: world_frame: found 5", "put it in quotes"]),
    "frame on": ("world_frame: on\n" + BODY, ["s.yaml:1: world_frame: found on", "put it in quotes"]),
    "frame empty": ("world_frame: ''\n" + BODY, ["s.yaml:1: world_frame: found ''", "name of a frame"]),
    "frame with slash": ("world_frame: /world\n" + BODY, ["s.yaml:1: world_frame: found /world", "leading /"]),
    "frame a list": ("world_frame: [a]\n" + BODY, ["s.yaml:1: world_frame: found [a]", "single name"]),
    "frames a list": (after("  frames: [a]"), ["s.yaml:5: body.frames: found [a]", "mapping from names"]),
    "fixed frame is world": (
        after("  frames: {world: {}}"),
        ["s.yaml:5: body.frames.world: ", "neither the world's nor"],
    ),
    "fixed frame is body": (
        after("  frames:\n    body: {}"),
        ["s.yaml:6: body.frames.body: ", "neither the world's nor"],
    ),
    "fixed frame badly named": (after("  frames: {a b: {}}"), ["s.yaml:5: body.frames.a b: ", "name of a frame"]),
    "fixed frame a vector": (
        after("  frames: {a: [0, 0, 0]}"),
        ["s.yaml:5: body.frames.a: found [0, 0, 0]", "position"],
    ),
    "fixed frame misplaced": (
        after("  frames: {a: {position: [0, 0]}}"),
        ["s.yaml:5: body.frames.a.position: found [0, 0]"],
    ),
    # Channels
    "wrenches a name": (after("wrenches: wrench"), ["s.yaml:5: wrenches: found wrench", "[{topic: wrench}]"]),
    "wrenches empty": (after("wrenches:"), ["s.yaml:5: wrenches: found nothing", "[] for none"]),
    "channel a name": (after("wrenches: [wrench]"), ["s.yaml:5: wrenches[0]: found wrench", "mapping of topic"]),
    "channel without topic": (after("wrenches: [{timeout: 1}]"), ["s.yaml:5: wrenches[0].topic: found nothing"]),
    "topic with space": (
        after("wrenches: [{topic: a b}]"),
        ["s.yaml:5: wrenches[0].topic: found a b", "ROS topic name"],
    ),
    "topic empty": (after("wrenches: [{topic: ''}]"), ["wrenches[0].topic: found ''", "ROS topic name"]),
    "topic ends in slash": (after("wrenches: [{topic: a/}]"), ["wrenches[0].topic: found a/"]),
    "topic with two slashes": (after("wrenches: [{topic: a//b}]"), ["wrenches[0].topic: found a//b"]),
    "topic begins with digit": (after("wrenches: [{topic: a/2b}]"), ["wrenches[0].topic: found a/2b", "digit"]),
    "topic with two underscores": (after("wrenches: [{topic: a__b}]"), ["wrenches[0].topic: found a__b"]),
    "topic private": (after("wrenches: [{topic: ~/a}]"), ["wrenches[0].topic: found ~/a"]),
    "topic with accent": (after("wrenches: [{topic: é}]"), ["wrenches[0].topic: found é"]),
    "topic a number": (after("wrenches: [{topic: 5}]"), ["wrenches[0].topic: found 5", "put it in quotes"]),
    "topic twice": (
        after("wrenches:\n- {topic: a}\n- {topic: a}"),
        ["s.yaml:7: wrenches[1].topic: found a again, first in wrenches[0].topic", "each topic once"],
    ),
    "topic twice, once absolute": (after("wrenches: [{topic: a}, {topic: /a}]"), ["wrenches[1].topic: found /a again"]),
    "topic of ours": (
        after("wrenches: [{topic: energy/work}]"),
        ["wrenches[0].topic: found energy/work", "publish itself"],
    ),
    "topic of the log": (after("wrenches: [{topic: a/applied}]"), ["wrenches[0].topic: found a/applied", "/applied"]),
    "max_force zero": (
        after("wrenches: [{topic: a, max_force: 0}]"),
        ["wrenches[0].max_force: found 0", "greater"],
    ),
    "max_torque no number": (after("wrenches: [{topic: a, max_torque: .inf}]"), ["wrenches[0].max_torque: found .inf"]),
    "on_excess unknown": (
        after("wrenches: [{topic: a, max_force: 1, on_excess: cut}]"),
        ["s.yaml:5: wrenches[0].on_excess: found cut, expected reject or clip; write reject or clip"],
    ),
    "on_excess of nothing": (
        after("wrenches: [{topic: a, on_excess: clip}]"),
        ["wrenches[0].on_excess: found no limit, expected max_force or max_torque; add one of them"],
    ),
    "timeout negative": (
        after("wrenches: [{topic: a, timeout: -1}]"),
        ["s.yaml:5: wrenches[0].timeout: found -1", "0 (hold"],
    ),
    "timeout that rounds to 0": (after("wrenches: [{topic: a, timeout: 1e-10}]"), ["wrenches[0].timeout: found 1e-10"]),
    "timeout beyond int64": (after("wrenches: [{topic: a, timeout: 1e11}]"), ["wrenches[0].timeout: found 1e11"]),
    "optional a number": (
        after("wrenches: [{topic: a, optional: 1}]"),
        ["wrenches[0].optional: found 1", "true or false"],
    ),
    # Effects
    "effect": (
        after("effects:\n- {type: drag}"),
        ["s.yaml:6: effects[0].type: found drag", "did you mean linear_drag?"],
    ),
    "effects a mapping": (after("effects: {type: drag}"), ["s.yaml:5: effects: found {type: drag}", "expected a list"]),
    # Solver
    "solver a name": (after("solver: rk4"), ["s.yaml:5: solver: found rk4", "mapping of method"]),
    "method unknown": (
        after("solver: {method: rkmk}"),
        ["s.yaml:5: solver.method: found rkmk, expected one of auto, ", "did you mean rkmk4?"],
    ),
    "method removed": (
        after("solver: {method: aba104}"),
        ["found aba104", "aba104 was removed; take dmv104, or strang6"],
    ),
    "method in capitals": (after("solver: {method: RK4}"), ["solver.method: found RK4", "did you mean rk4?"]),
    "method far from all": (after("solver: {method: zzzz}"), ["solver.method: found zzzz", "write auto"]),
    "method a number": (after("solver: {method: 4}"), ["s.yaml:5: solver.method: found 4", "rkmk4"]),
    "step and accuracy": (
        after("solver:\n  step: 0.1\n  accuracy: 0.1"),
        ["solver: found both step and accuracy", "remove the other"],
    ),
    "step zero": (after("solver: {step: 0}"), ["s.yaml:5: solver.step: found 0, expected a number from 1e-09"]),
    "step negative": (after("solver: {step: -0.01}"), ["s.yaml:5: solver.step: found -0.01"]),
    "step below 1 ns": (after("solver: {step: 9e-10}"), ["s.yaml:5: solver.step: found 9e-10", "nanoseconds"]),
    "step beyond int64": (after("solver: {step: 1e10}"), ["s.yaml:5: solver.step: found 1e10"]),
    "accuracy zero": (
        after("solver: {accuracy: 0}"),
        ["s.yaml:5: solver.accuracy: found 0, expected a number greater than 0"],
    ),
    "accuracy one": (after("solver: {accuracy: 1.0}"), ["s.yaml:5: solver.accuracy: found 1.0", "less than 1"]),
    # Time
    "duration zero": (after("duration: 0"), ["s.yaml:5: duration: found 0, expected a number from 1e-09"]),
    "duration negative": (after("duration: -60"), ["s.yaml:5: duration: found -60"]),
    "duration beyond int64": (after("duration: 9.3e9"), ["s.yaml:5: duration: found 9.3e9", "64-bit nanoseconds"]),
    "duration infinite": (after("duration: .inf"), ["s.yaml:5: duration: found .inf", "infinities"]),
    "duration empty": (after("duration:"), ["s.yaml:5: duration: found nothing", "remove it"]),
    "output_rate negative": (after("output_rate: -1"), ["s.yaml:5: output_rate: found -1, expected 0 (every step)"]),
    "output_rate above 1 GHz": (after("output_rate: 1.1e9"), ["s.yaml:5: output_rate: found 1.1e9", "1e+09 (Hz)"]),
    "output_rate beyond int64": (after("output_rate: 1e-11"), ["s.yaml:5: output_rate: found 1e-11"]),
}


@pytest.mark.parametrize(("text", "fragments"), CASES.values(), ids=CASES.keys())
def test_error_names_place_value_and_remedy(text: str, fragments: list[str]) -> None:
    message = error_of(text)
    for fragment in fragments:
        assert fragment in message
    assert len(message.splitlines()) == 1, "one mistake is reported once"
    assert "expected" in message
    assert message.isprintable()


def test_all_problems_are_reported_in_the_order_of_the_file() -> None:
    text = "duration: -1\nbody:\n  mass: -1\n  inertia: {diagonal: [1, 1, 3]}\nsolver: {step: 0}\ninitial: 3\n"
    lines = error_of(text).splitlines()
    assert [line.split(": ")[:2] for line in lines] == [
        ["s.yaml:1", "duration"],
        ["s.yaml:3", "body.mass"],
        ["s.yaml:4", "body.inertia.diagonal"],
        ["s.yaml:5", "solver.step"],
        ["s.yaml:6", "initial"],
    ]


def test_many_problems_are_cut() -> None:
    lines = error_of(BODY + "".join(f"key_{i}: 1\n" for i in range(MAX_REPORTED + 5))).splitlines()
    assert len(lines) == MAX_REPORTED + 1
    assert lines[-1] == "s.yaml: and 5 more problems; correct these first"


def test_two_forms_are_one_too_many() -> None:
    assert "found diagonal and shape" in error_of(inertia("{diagonal: [1, 2, 3], shape: {type: box}}"))


def test_advice_on_the_name_of_a_sensor_is_not_that_for_a_channel() -> None:
    text = error_of(BODY + "sensors: [{type: imu, name: pose, rate: 10}]\n")
    assert "expected a topic that rb_dynamics does not publish itself; take another name" in text
