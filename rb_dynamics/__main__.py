"""`python -m rb_dynamics` is the command line."""

import sys

from rb_dynamics.cli import main

sys.exit(main())
