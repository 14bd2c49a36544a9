"""Types of the arrays that rooms hand to each other; shapes and units stand where an array is
used.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
AnyArray = npt.NDArray[Any]
