"""Array types for annotations, with dtypes and dimensions.

A named size is the same in all arguments and the result of one call: ``n`` is the number of
coordinates of a state. ``_`` is any size.
"""

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

#: A state, or an increment of one.
StateVector = Float[np.ndarray, "n"]

#: States, one per row.
StateVectors = Float[np.ndarray, "_ n"]

Numbers = Float[np.ndarray, "_"]
Matrix = Float[np.ndarray, "_ _"]
Matrices = Float[np.ndarray, "_ _ _"]
ComplexNumbers = Complex[np.ndarray, "_"]
Integers = Int[np.ndarray, "_"]
IntegerMatrix = Int[np.ndarray, "_ _"]
Mask = Bool[np.ndarray, "_"]
MaskMatrix = Bool[np.ndarray, "_ _"]
