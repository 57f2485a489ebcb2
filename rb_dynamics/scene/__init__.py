"""Scene files: from YAML to a validated `Scene`, and from a scene to the smallest model that describes it."""

from rb_dynamics.scene.read import opened, parse_scene, read_scene

__all__ = ["opened", "parse_scene", "read_scene"]
