"""rb_dynamics: one free-floating rigid body, simulated to round-off; this package is the library without ROS.

Conventions, kept everywhere:

- SI units. Time is integer nanoseconds since the start of a run.
- The world frame is inertial. The body frame is fixed to the body; its origin is the body origin; the centre of mass
  sits at `center_of_mass` in it. Vector names end in the axes they are expressed in: `_world`, `_body`.
- Attitude is the rotation from body to world axes; quaternions are (x, y, z, w), as in ROS and scipy.
- Inertia is about the centre of mass, in body axes, with products as they stand in the matrix (Ixy = -int xy dm).

The data takes one way: a scene is read and checked (`scene`), compiled to the smallest model that moves it and advanced
by one engine (`run`), and the results go to sinks (`sinks`, `ros`). Each part imports only those before it: `errors`,
`plugins`, `numerics`, `formats`, `body`, `loads`, `sensors`, `motion`, `theory`, `scene`, `run`, `logs`, `sinks`,
`conversion`, `analysis`, `study`, `report`, `ros`, `cli`.
Nothing is imported before it is used: neither optional libraries nor, on `import rb_dynamics`, the modules behind its
names.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_HOMES = {line.split()[-1]: line.split()[1] for line in _STUB.splitlines() if line.startswith("from ")}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    """Import the object of a public name, a subpackage or the version when it is first used."""
    if name == "__version__":
        return import_module(f"{__name__}.formats.log_metadata").version()
    home = _HOMES.get(name, f"{__name__}.{name}")
    try:
        module = import_module(home)
    except ModuleNotFoundError as error:
        if error.name != home:
            raise
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    if name not in _HOMES:
        return module
    # `poinsot` and `euler_equations` are modules themselves, found in their folder once they are imported.
    value: object = getattr(module, name) if hasattr(module, name) else import_module(f"{home}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
