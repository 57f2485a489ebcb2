"""rb_dynamics: one free-floating rigid body, simulated to round-off; this package is the library without ROS.

Conventions, kept everywhere:

- SI units. Time is integer nanoseconds since the start of a run.
- The world frame is inertial. The body frame is fixed to the body; its origin is the body origin; the centre of mass
  sits at `center_of_mass` in it. Vector names end in the axes they are expressed in: `_world`, `_body`.
- Attitude is the rotation from body to world axes; quaternions are (x, y, z, w), as in ROS and scipy.
- Inertia is about the centre of mass, in body axes, with products as they stand in the matrix (Ixy = -int xy dm).

The way of the data: a scene is read (`scene`), compiled to a method and a step control (`scene.compile`), advanced by
one loop (`simulate`), and what happens goes to sinks (`recording`). Each part imports only those before it: `vector`,
`rotation`, `body`, `loads`, `motion`, `scene`, `diagnostics`, `recording`, `simulate`, `explain`, `report`,
`ros`, `cli`.
Optional libraries are imported where they are used, never by `import rb_dynamics`.
"""

from rb_dynamics.body.doctor import Finding, Symmetry, examine, symmetry
from rb_dynamics.body.particles import body_of_particles
from rb_dynamics.body.properties import inertia_ellipsoid, radius_of_gyration, scalar_inertia
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.diagnostics import Sample
from rb_dynamics.errors import (
    BodyError,
    ConvergenceError,
    LogError,
    MissingExtraError,
    RigidBodyError,
    SceneError,
    WrenchError,
)
from rb_dynamics.explain import Explanation, explain
from rb_dynamics.loads.central_gravity import CentralGravity
from rb_dynamics.loads.channels import AppliedWrench, Channel
from rb_dynamics.loads.drag import LinearDrag, QuadraticDrag
from rb_dynamics.loads.effect import Effect
from rb_dynamics.loads.rotor import Rotor
from rb_dynamics.loads.scheduled_wrench import ScheduledWrench
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.loads.wrench import FixedFrame, Wrench, WrenchFrames
from rb_dynamics.motion import METHODS
from rb_dynamics.motion.free_motion import FreeMotion, free_motion
from rb_dynamics.recording.memory import MemorySink
from rb_dynamics.recording.sink import Sink
from rb_dynamics.recording.state_hash import HashSink
from rb_dynamics.scene import parse_scene, read_scene
from rb_dynamics.scene.model import Scene, Solver
from rb_dynamics.simulate import Run, Simulation, simulate

__all__ = [
    "METHODS",
    "AppliedWrench",
    "BodyError",
    "CentralGravity",
    "Channel",
    "ConvergenceError",
    "Effect",
    "Explanation",
    "Finding",
    "FixedFrame",
    "FreeMotion",
    "HashSink",
    "LinearDrag",
    "LogError",
    "MemorySink",
    "MissingExtraError",
    "QuadraticDrag",
    "RigidBody",
    "RigidBodyError",
    "Rotor",
    "Run",
    "Sample",
    "Scene",
    "SceneError",
    "ScheduledWrench",
    "Simulation",
    "Sink",
    "Solver",
    "State",
    "Symmetry",
    "UniformGravity",
    "Wrench",
    "WrenchError",
    "WrenchFrames",
    "body_of_particles",
    "examine",
    "explain",
    "free_motion",
    "inertia_ellipsoid",
    "parse_scene",
    "radius_of_gyration",
    "read_scene",
    "scalar_inertia",
    "simulate",
    "symmetry",
]
