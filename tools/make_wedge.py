"""Write config/meshes/wedge.stl, the mesh of config/mesh.yaml: a door stop, in mm and as ASCII.

A triangle in x and z, drawn along y; 120 mm long, 40 mm wide, 30 mm high at its thick end.
"""

from __future__ import annotations

from pathlib import Path

LENGTH, WIDTH, HEIGHT = 120, 40, 30
OUTPUT = Path(__file__).resolve().parents[1] / "config" / "meshes" / "wedge.stl"

Corner = tuple[int, int, int]

# Tip, heel and top of the near side (y = 0) and of the far side.
A, B, C = (0, 0, 0), (LENGTH, 0, 0), (LENGTH, 0, HEIGHT)
D, E, F = (0, WIDTH, 0), (LENGTH, WIDTH, 0), (LENGTH, WIDTH, HEIGHT)
TRIANGLES = [(A, B, C), (D, F, E), (A, D, E), (A, E, B), (B, E, F), (B, F, C), (A, C, F), (A, F, D)]


def normal(a: Corner, b: Corner, c: Corner) -> tuple[float, float, float]:
    """Return the unit normal of a triangle whose corners run counterclockwise seen from outside."""
    u, v = ([q - p for p, q in zip(a, other, strict=True)] for other in (b, c))
    n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    length = sum(x * x for x in n) ** 0.5
    return (n[0] / length, n[1] / length, n[2] / length)


def stl() -> str:
    """Return the wedge as ASCII STL."""
    lines = ["solid wedge"]
    for corners in TRIANGLES:
        lines.append("  facet normal {:.9g} {:.9g} {:.9g}".format(*(x + 0.0 for x in normal(*corners))))
        lines.append("    outer loop")
        lines += ["      vertex {} {} {}".format(*corner) for corner in corners]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, "endsolid wedge", ""])


if __name__ == "__main__":
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text(stl(), encoding="ascii")
