"""Docstrings as the reference shows them.

Roles such as ``:func:`simulate```, and pages of the documentation, become links. Where one entry
describes several parameters each has its own default and type.
"""

import re

import griffe

import hybrid

ROLE = re.compile(r":\w+:`~?\.?([\w.]+)`")

#: A page, as it is named in a docstring; the entries are in pages of the folder reference/.
PAGE = re.compile(r"``docs/([\w/-]+)\.md``")

#: The line that begins an entry, with its type.
TYPED = re.compile(r"^[\w, *]+ : .*$", re.MULTILINE)


def link(role: re.Match) -> str:
    """A public name with a link to its entry; any other as code."""
    name = role[1].rpartition(".")[2]
    return f"[`{name}`][hybrid.{name}]" if name in hybrid.__all__ else f"`{role[1]}`"


class Roles(griffe.Extension):
    """Runs over every object that is read."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        if not obj.docstring:
            return
        text = PAGE.sub(r"[\1](../\1.md)", ROLE.sub(link, obj.docstring.value))
        obj.docstring.value = TYPED.sub(lambda line: line[0].replace("``", ""), text)
        if obj.is_function:
            for section in obj.docstring.parsed:
                if section.kind is griffe.DocstringSectionKind.parameters:
                    for entry in section.value:
                        own(entry, obj.parameters)


def own(entry: griffe.DocstringParameter, parameters: griffe.Parameters) -> None:
    """The default of a parameter, and its type where the entry itself names none."""
    parameter = parameters[entry.name.strip("*")]
    entry.value = None if parameter.kind is griffe.ParameterKind.var_keyword else parameter.default
    if any(entry.annotation is other.annotation for other in parameters):
        entry.annotation = parameter.annotation
