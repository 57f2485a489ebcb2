"""Ten thousand held wrenches in each frame: driven for 100 s, and still where the 30 digits say.

A body-frame and a world-frame wrench, each with force and torque, change every 0.01 s; the body is triaxial with
off-diagonal inertia and its centre of mass off its origin. `make_reference.py` makes commands and states alike.
"""

from __future__ import annotations

import json
from functools import cache

import pytest
from motions import DATA, EPS, Recorder, attitude_error, scene, vector_error
from test_references import load_generator

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.diagnostics import Sample
from rb_dynamics.loads.channels import Channel
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.scene.model import Solver
from rb_dynamics.simulate import Run, simulate
