"""Scene files: from YAML to a validated `Scene`, and from a scene to the least model that moves it."""

from rb_dynamics.scene.read import opened, parse_scene, read_scene

__all__ = ["opened", "parse_scene", "read_scene"]
