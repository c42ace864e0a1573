"""Rules, once: small scalar functions that are machine code, or plain Python, from one text.

``docs/notes/rules.md`` says what a rule file may contain, and how one is added.
"""

from functools import cache
from threading import RLock
from typing import Any

from .load import Library

#: A run of any solver needs the first two; where contacts are, the loop and the sum, and where it
#: is long, what programs are compiled of.
library = Library(
    __name__,
    together=(("zeros", "jets"), ("runs", "sums", "bounds", "operation")),
)

_loading = RLock()


@cache
def unit(name: str) -> Any:
    """The rules of one file by name, compiled when first asked for: ``unit("zeros").first(...)``.

    One thread at a time loads them: of two that do, one lets go what the other runs.
    """
    with _loading:
        return library.unit(name)
