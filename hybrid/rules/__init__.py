"""Rules, once: small scalar functions that are machine code, or plain Python, from one text.

``docs/notes/rules.md`` says what a rule file may contain, and how one is added.
"""

from .load import Library

library = Library(__name__)

#: ``unit("zeros").first(...)``: the rules of one file by name, compiled when first asked for.
unit = library.unit
