"""Type alias `FloatArray` for NumPy arrays of double-precision numbers.

All packages but `pyomo_quad.collocation` import the alias from here. That package must not import
other parts of `pyomo_quad`, and therefore defines the same alias for itself, in `collocation.mesh`.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
