"""The type of arrays of numbers; the engine stands alone and has its own in `collocation.mesh`."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
