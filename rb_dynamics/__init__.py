"""rb_dynamics: one free-floating rigid body, simulated to round-off; this package is the library without ROS.

Conventions, kept everywhere:

- SI units. Time is integer nanoseconds since the start of a run.
- The world frame is inertial. The body frame is fixed to the body; its origin is the body origin; the centre of mass
  sits at `center_of_mass` in it. Vector names end in the axes they are expressed in: `_world`, `_body`.
- Attitude is the rotation from body to world axes; quaternions are (x, y, z, w), as in ROS and scipy.
- Inertia is about the centre of mass, in body axes, with products as they stand in the matrix (Ixy = -int xy dm).

The way of the data: a scene is read (`scene`), compiled to a method and a step control (`scene.compile`), advanced by
one loop (`simulate`), and what happens goes to sinks (`recording`). Each part imports only those before it: `errors`,
`plugins`, `vector`, `rotation`, `rotations`, `arguments`, `decimals`, `options`, `moments`, `sincos`, `compiled`,
`elliptic`, `shipped`, `body`, `euler_equations`, `contact`, `loads`, `motion`, `poinsot`, `diagnostics`, `samples`,
`ensemble`, `scene`, `recording`, `simulate`, `replay`, `stopwatch`, `explain`, `trade`, `report`, `campaign`,
`stopping`, `ros`, `cli`.
Nothing is imported before it is used: not by `import rb_dynamics` what stands behind a name, nor optional libraries.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
    from rb_dynamics.body.mass_properties import inertia_ellipsoid as inertia_ellipsoid
    from rb_dynamics.body.mass_properties import radius_of_gyration as radius_of_gyration
    from rb_dynamics.body.mass_properties import scalar_inertia as scalar_inertia
    from rb_dynamics.body.particles import body_of_particles as body_of_particles
    from rb_dynamics.body.plausibility import Finding as Finding
    from rb_dynamics.body.plausibility import Symmetry as Symmetry
    from rb_dynamics.body.plausibility import examine as examine
    from rb_dynamics.body.plausibility import symmetry as symmetry
    from rb_dynamics.body.rigid_body import RigidBody as RigidBody
    from rb_dynamics.body.state import State as State
    from rb_dynamics.errors import BodyError as BodyError
    from rb_dynamics.errors import ConvergenceError as ConvergenceError
    from rb_dynamics.errors import LogError as LogError
    from rb_dynamics.errors import MissingExtraError as MissingExtraError
    from rb_dynamics.errors import PluginError as PluginError
    from rb_dynamics.errors import RigidBodyError as RigidBodyError
    from rb_dynamics.errors import SceneError as SceneError
    from rb_dynamics.errors import WrenchError as WrenchError
    from rb_dynamics.loads.central_gravity import CentralGravity as CentralGravity
    from rb_dynamics.loads.channels import AppliedWrench as AppliedWrench
    from rb_dynamics.loads.channels import Channel as Channel
    from rb_dynamics.loads.drag import LinearDrag as LinearDrag
    from rb_dynamics.loads.drag import QuadraticDrag as QuadraticDrag
    from rb_dynamics.loads.effect import Effect as Effect
    from rb_dynamics.loads.rotor import Rotor as Rotor
    from rb_dynamics.loads.scheduled_wrench import ScheduledWrench as ScheduledWrench
    from rb_dynamics.loads.uniform_gravity import UniformGravity as UniformGravity
    from rb_dynamics.loads.wrench import FixedFrame as FixedFrame
    from rb_dynamics.loads.wrench import Wrench as Wrench
    from rb_dynamics.loads.wrench import WrenchFrames as WrenchFrames
    from rb_dynamics.motion import METHODS as METHODS
    from rb_dynamics.motion.free_motion import FreeMotion as FreeMotion
    from rb_dynamics.motion.free_motion import free_motion as free_motion
    from rb_dynamics.recording.memory import MemorySink as MemorySink
    from rb_dynamics.recording.state_hash import HashSink as HashSink
    from rb_dynamics.run.diagnostics import Sample as Sample
    from rb_dynamics.run.ensemble import Ensemble as Ensemble
    from rb_dynamics.run.ensemble import driven_motion as driven_motion
    from rb_dynamics.run.samples import Samples as Samples
    from rb_dynamics.run.simulation import Run as Run
    from rb_dynamics.run.simulation import Simulation as Simulation
    from rb_dynamics.run.simulation import simulate as simulate
    from rb_dynamics.run.sink import Sink as Sink
    from rb_dynamics.scene import parse_scene as parse_scene
    from rb_dynamics.scene import read_scene as read_scene
    from rb_dynamics.scene.model import Scene as Scene
    from rb_dynamics.scene.model import Solver as Solver
    from rb_dynamics.study.explain import Explanation as Explanation
    from rb_dynamics.study.explain import explain as explain
    from rb_dynamics.study.trade import Trade as Trade
    from rb_dynamics.study.trade import trade as trade

_HOMES = {
    "Finding": "body.doctor",
    "Symmetry": "body.doctor",
    "examine": "body.doctor",
    "symmetry": "body.doctor",
    "body_of_particles": "body.particles",
    "inertia_ellipsoid": "body.properties",
    "radius_of_gyration": "body.properties",
    "scalar_inertia": "body.properties",
    "RigidBody": "body.rigid_body",
    "State": "body.state",
    "Sample": "diagnostics",
    "Ensemble": "ensemble",
    "driven_motion": "ensemble",
    "BodyError": "errors",
    "ConvergenceError": "errors",
    "LogError": "errors",
    "MissingExtraError": "errors",
    "PluginError": "errors",
    "RigidBodyError": "errors",
    "SceneError": "errors",
    "WrenchError": "errors",
    "Explanation": "explain",
    "explain": "explain",
    "CentralGravity": "loads.central_gravity",
    "AppliedWrench": "loads.channels",
    "Channel": "loads.channels",
    "LinearDrag": "loads.drag",
    "QuadraticDrag": "loads.drag",
    "Effect": "loads.effect",
    "Rotor": "loads.rotor",
    "ScheduledWrench": "loads.scheduled_wrench",
    "UniformGravity": "loads.uniform_gravity",
    "FixedFrame": "loads.wrench",
    "Wrench": "loads.wrench",
    "WrenchFrames": "loads.wrench",
    "METHODS": "motion",
    "FreeMotion": "motion.free_motion",
    "free_motion": "motion.free_motion",
    "MemorySink": "recording.memory",
    "Sink": "recording.sink",
    "HashSink": "recording.state_hash",
    "Samples": "samples",
    "parse_scene": "scene",
    "read_scene": "scene",
    "Scene": "scene.model",
    "Solver": "scene.model",
    "Run": "simulate",
    "Simulation": "simulate",
    "simulate": "simulate",
    "Trade": "trade",
    "trade": "trade",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    """Import what stands behind a public name, or a submodule, when it is first asked for; so too the version."""
    if name == "__version__":
        return import_module(f"{__name__}.recording.provenance").version()
    home = _HOMES.get(name, name)
    try:
        module = import_module(f"{__name__}.{home}")
    except ModuleNotFoundError as error:
        if error.name != f"{__name__}.{home}":
            raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    if name not in _HOMES:
        return module
    value: object = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})


class _Package(ModuleType):
    def __setattr__(self, name: str, value: object) -> None:
        # Python binds a submodule to its package; `simulate`, `explain` and `trade` are functions.
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
