"""Read files that describe a body (meshes, URDF): plain files only, up to a size limit, and no URLs."""

from __future__ import annotations

import os
import stat

from rb_dynamics.errors import BodyError


def read_bounded(path: str | os.PathLike[str], limit: int, what: str) -> bytes:
    """Return the bytes of `path`, a plain file of at most `limit` bytes that holds `what`.

    Raises:
        BodyError: it is a URL, not a plain file, not readable, or larger.
    """
    name = os.fspath(path)
    if "://" in name:
        raise BodyError(
            f"file is {name!r}, expected the path of {what} on this machine; "
            "URLs, package:// among them, are not followed: write the path, relative to the scene file"
        )
    try:
        # Before it is opened: opening a pipe would wait for its other end.
        if not stat.S_ISREG(os.stat(name).st_mode):
            raise BodyError(f"{name} is not a regular file, expected {what}; check the path")
        with open(name, "rb") as file:
            data = file.read(limit + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BodyError(f"{name} cannot be read ({reason}), expected {what}; check the path") from error
    if len(data) > limit:
        raise BodyError(f"{name} has more than {limit >> 20} MiB, expected {what} of at most that; use a coarser one")
    return data
