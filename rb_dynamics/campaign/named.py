"""What a campaign names: a law or a function of this package, or of the user's own by its dotted name."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from rb_dynamics.errors import SceneError


def named(name: str, known: Mapping[str, Callable[..., Any]], folder: str) -> Callable[..., Any]:
    """Return what is `known` by `name`, or the function `module.function`; modules may lie in `folder`.

    Raises:
        SceneError: there is no such module or function.
    """
    if name in known:
        return known[name]
    module, dot, function = name.rpartition(".")
    if not dot:
        raise SceneError(f"found {name}, expected one of {', '.join(known)}, or module.function; correct the name")
    if folder not in sys.path:
        # Behind all others, so that a file there never hides a library.
        sys.path.append(folder)
    try:
        found = getattr(import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise SceneError(
            f"found {name}, expected a function that can be imported ({error}); put its module beside the campaign "
            "file or install it"
        ) from error
    if not callable(found):
        raise SceneError(f"found {name}, which is {found!r}, expected a function; correct the name")
    result: Callable[..., Any] = found
    return result
