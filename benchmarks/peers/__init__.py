"""The other simulators, one file each; `problem.py` defines the problems and the interface of a peer."""
