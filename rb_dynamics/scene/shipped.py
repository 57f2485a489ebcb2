"""Find the scenes and the recording in the package: source tree, pip install or colcon workspace."""

from __future__ import annotations

import sys
from pathlib import Path

from rb_dynamics.errors import SceneError

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped(name: str) -> Path:
    """Return the path of a file of the package such as "config/slew.yaml" or "examples/slew.mcap".

    Raises:
        SceneError: it is in none of the places where an installation puts it.
    """
    share = Path("share", "rb_dynamics")
    # <prefix>/lib/pythonX.Y/site-packages/rb_dynamics, and the same without a virtual environment's prefix.
    places = [_PACKAGE.parent, *(parent / share for parent in _PACKAGE.parents[1:5]), Path(sys.prefix) / share]
    for place in places:
        if (place / name).is_file():
            return place / name
    raise SceneError(f"{name}: not found beside the package in {_PACKAGE}; install rb_dynamics again")
