"""Rules, once: small scalar functions that are machine code, or plain Python, from one text.

``docs/notes/rules.md`` says what a rule file may contain, and how one is added.
"""

from .load import Library

#: A run of any solver needs the first two; where contacts are, the loop and the sum, and where it
#: is long, what programs are compiled of.
library = Library(
    __name__,
    together=(("zeros", "jets"), ("runs", "sums", "bounds", "operation")),
)

#: ``unit("zeros").first(...)``: the rules of one file by name, compiled when first asked for.
unit = library.unit
