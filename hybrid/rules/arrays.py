"""Names for what rules take, in annotations: from these their machine code gets its types."""

from typing import Any

#: Contiguous arrays of ``float64``, with one axis or two.
Floats = Any
Matrix = Any

#: Contiguous arrays of ``int64``, with one axis or two.
Ints = Any
Table = Any
