"""What arrays hold, for annotations: their numbers and dimensions.

A size that has a letter is one size in all arguments of a call, and in what it returns: ``n`` is
the number of coordinates of a state. ``_`` is any size.
"""

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

#: A state, or what is added to one.
StateVector = Float[np.ndarray, "n"]

#: States, a row each.
StateVectors = Float[np.ndarray, "_ n"]

Numbers = Float[np.ndarray, "_"]
Matrix = Float[np.ndarray, "_ _"]
Matrices = Float[np.ndarray, "_ _ _"]
ComplexNumbers = Complex[np.ndarray, "_"]
Integers = Int[np.ndarray, "_"]
IntegerMatrix = Int[np.ndarray, "_ _"]
Mask = Bool[np.ndarray, "_"]
MaskMatrix = Bool[np.ndarray, "_ _"]
