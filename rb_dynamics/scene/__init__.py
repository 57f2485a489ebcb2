"""Scene files: from YAML to a validated `Scene`, and from a scene to what runs."""

from rb_dynamics.scene.read import parse_scene, read_scene

__all__ = ["parse_scene", "read_scene"]
