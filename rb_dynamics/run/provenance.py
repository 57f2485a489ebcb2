"""Where a run comes from: the metadata that a log carries so that the run can be repeated and checked."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rb_dynamics.scene.model import Scene

SCENE = "scene.yaml"
"""Name of the attachment of a log that is its scene."""

RUN = "rb_dynamics"
"""Name of the metadata of a log that says what was run: `run_metadata`."""

RESULT = "rb_dynamics.result"
"""Name of the metadata of a log that says how its run ended."""

CONTINUES_IN = "continues_in"
"""What says in it, of a file that is not the last of a bag, which file comes next: such a result is no end of a run."""

INTERRUPTED = "rb_dynamics.interrupted"
"""Name of the metadata that a log has whose run, disk or power ended before the log was finished."""

CUT_OFF, DAMAGED = "cut off", "damaged"
"""What `reason` says in it of a file that was recovered; "cut off and damaged" of one that was both."""

MISSING_FILES = "missing_files"
"""What names in it the files of a bag that are not there although later ones are."""

TOPICS = "rb_dynamics.topics"
"""Name of the metadata of a log that gives each topic's name in the log by its name in the scene."""

INPUTS_RULE = "inputs_rule"
"""What says in the result by which rule `inputs_sha256` was made; absent in logs of the first."""

CHECKPOINT = "rb_dynamics.checkpoint"
"""Name of the metadata that follows the samples in a log as they are written: how many, and the hash of all of them."""

_PACKAGES = ("rb_dynamics", "numpy", "scipy", "PyYAML", "zstandard", "rerun-sdk")


def next_file(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return which file of a bag comes behind the one of this metadata; "" where it is the last, or does not say."""
    return metadata.get(RESULT, {}).get(CONTINUES_IN, "")


@functools.cache
def version(package: str = "rb_dynamics") -> str:
    """Return the installed version of `package`, or "not installed", as it was when first asked."""
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def run_metadata(scene: Scene, method: str, solver: str) -> dict[str, str]:
    """Return what is known when a run begins: software, platform, method, hash of the scene. Values are text.

    `seed` is empty: nothing in a run is random.
    """
    import platform
    from pathlib import PurePath

    from rb_dynamics.loads.effect_types import EFFECTS
    from rb_dynamics.motion import METHODS

    origins = [METHODS.origin(scene.solver.method), *(EFFECTS.origin(effect.kind) for effect in scene.effects)]
    plugins = ", ".join(dict.fromkeys(filter(None, origins)))
    return {
        "scene_file": PurePath(scene.source).name,
        "scene_sha256": hashlib.sha256(scene.text.encode()).hexdigest(),
        "method": method,
        "solver": solver,
        "seed": "",
        "effects": ", ".join(effect.kind for effect in scene.effects),
        "effects_not_logged_as_wrench": ", ".join(scene.combined_effects.varying),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        **{f"version.{package}": version(package) for package in _PACKAGES},
        **({"plugins": plugins} if plugins else {}),
    }
