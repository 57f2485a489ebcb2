"""A plug-in of rb_dynamics: one file for each thing that it brings; pyproject.toml names them."""
