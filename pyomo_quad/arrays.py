"""Type alias `FloatArray` for NumPy arrays of double-precision numbers.

The package `pyomo_quad.collocation` defines an alias of its own in `collocation.mesh`, because it
must not import other parts of `pyomo_quad`. All other packages import the alias from here.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
