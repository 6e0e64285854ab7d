"""Type alias `FloatArray` for NumPy arrays of double-precision numbers.

The package `pyomo_quad.collocation` imports nothing from the rest of `pyomo_quad`, and defines the
same alias for itself in `collocation.mesh`.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
