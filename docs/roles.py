"""Docstrings as Markdown: roles such as ``:func:`hybrid.simulate``` become links of the reference."""

import re

import griffe

import hybrid

ROLE = re.compile(r":\w+:`~?\.?([\w.]+)`")


def link(role: re.Match) -> str:
    """A public name with a link to its entry; any other as code."""
    name = role[1].rpartition(".")[2]
    return f"[`{name}`][hybrid.{name}]" if name in hybrid.__all__ else f"`{role[1]}`"


class Roles(griffe.Extension):
    """Runs over every object that is read."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        if obj.docstring:
            obj.docstring.value = ROLE.sub(link, obj.docstring.value)
