"""`python -m pyomo_quad` is `pyomo-quad`."""

import sys

from pyomo_quad.cli import main

if __name__ == "__main__":
    sys.exit(main())
