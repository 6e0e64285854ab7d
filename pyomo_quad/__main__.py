"""Entry point of `python -m pyomo_quad`, which runs the `pyomo-quad` command."""

import sys

from pyomo_quad.cli import main

if __name__ == "__main__":
    sys.exit(main())
