"""What a command is given, as text: checked before anything is run."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from .. import gallery
from ..errors import FILES, HTML, PLOT, OptionError, StartError, need
from ..plot import is_page, require_writable
from ..result.files import require_netcdf
from .options import (
    Absolute,
    Before,
    Choice,
    FirstStep,
    LongestStep,
    MemoryKind,
    MethodName,
    ModeAtStart,
    ModelName,
    MostJumps,
    Parameters,
    Reader,
    Relative,
    Since,
    SolverName,
    States,
    Until,
    with_options,
)


@attrs.frozen
class GivenRun:
    """A model of a file and a run of it: the one that the file suggests, but for what was given.

    ``run``: the model, its start, first and last time; ``options``: those of a run.
    """

    entry: gallery.GalleryEntry
    run: tuple[Any, dict[str, Any], tuple[float, float]]
    options: dict[str, Any]


def asked(
    model: ModelName,
    set_: Parameters = None,
    start: States = None,
    since: Since = None,
    until: Until = None,
    history: Before = None,
    memory: MemoryKind = "keep",
) -> GivenRun:
    """What the options say that all commands have which run a model."""
    entry = gallery.find(model)
    made = entry.cls(**pairs(set_ or [], "--set"))
    first = _start(entry, pairs(start or [], "--start"))
    before = _history(entry, pairs(history or [], "--history"))
    options = {"history": before, "memory": memory}
    return GivenRun(entry, (made, first, _span(entry, since, until)), options)


@with_options(asked)
def flown(
    given: Reader,
    solver: SolverName = "scipy",
    method: MethodName = None,
    rtol: Relative = None,
    atol: Absolute = None,
    max_step: LongestStep = None,
    first_step: FirstStep = None,
    zeno: Choice = "rest",
    mode: ModeAtStart = None,
    max_jumps: MostJumps = None,
) -> GivenRun:
    """What the options say of a run, and of how it is computed."""
    options = {"solver": solver, "method": method, "rtol": rtol, "atol": atol, "zeno": zeno}
    options |= {"max_step": max_step, "first_step": first_step, "mode": mode}
    known = given()
    return attrs.evolve(known, options=known.options | options | {"max_jumps": max_jumps})


def pairs(given: list[str], option: str) -> dict[str, Any]:
    """Names with numbers, or lists of them."""
    found = {}
    for text in given:
        name, equals, value = text.partition("=")
        try:
            found[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            equals = ""
        if not equals:
            raise OptionError(f"{option} {text}: write NAME=NUMBER, or NAME=[NUMBER,NUMBER]")
    return found


def values(given: list[str]) -> dict[str, Any]:
    """Names with a row of numbers each: ``r=0.3:0.9:40``, from, to and how many, or a list."""
    found = {}
    for text in given:
        name, _, said = text.partition("=")
        parts = said.split(":")
        try:
            if len(parts) == 3:
                found[name.strip()] = np.linspace(float(parts[0]), float(parts[1]), int(parts[2]))
                continue
        except ValueError:
            parts = []
        if len(parts) != 1:
            raise OptionError(f"--over {text}: write NAME=FROM:TO:COUNT, or NAME=[NUMBER,NUMBER]")
        found |= pairs([text], "--over")
    return found


def _start(entry: gallery.GalleryEntry, given: dict[str, Any]) -> dict[str, Any]:
    start = {**(entry.start or {}), **given}
    missing = [name for name in (s.name for s in entry.cls.spec.flowing) if name not in start]
    if missing:
        raise StartError(
            f"{entry.cls.__name__}: no start for {', '.join(missing)}; "
            f"add --start {missing[0]}=NUMBER, or START = {{...}} to the file"
        )
    return start


def _history(entry: gallery.GalleryEntry, given: dict[str, Any]) -> Any:
    """What was before the start: the file's, but for the states given."""
    if not given:
        return entry.history
    if callable(entry.history):
        raise OptionError("--history: the file's HISTORY is a function, not a dict of states")
    return {**(entry.history or {}), **given}


def _span(
    entry: gallery.GalleryEntry, since: float | None, until: float | None
) -> tuple[float, float]:
    t0 = since if since is not None else (entry.until[0] if entry.until else 0.0)
    if until is None and not entry.until:
        raise OptionError(f"{entry.cls.__name__}: no last time; add --until NUMBER")
    return t0, until if until is not None else entry.until[1]


def tolerances(text: str) -> list[float]:
    """Tolerances listed, or a range of powers of ten."""
    first, dots, last = text.partition("..")
    try:
        if not dots:
            return [float(value) for value in text.split(",")]
        high, low = (round(math.log10(float(end))) for end in (first, last))
        if [float(first), float(last)] != [float(f"1e{power}") for power in (high, low)]:
            raise ValueError
    except ValueError:
        raise OptionError(f"--rtol {text}: write 1e-4,1e-8 or 1e-4..1e-12") from None
    step = 1 if low >= high else -1
    return [float(f"1e{power}") for power in range(high, low + step, step)]


def bounds(given: list[str]) -> dict[str, tuple[float, float]]:
    """Names with two ends."""
    found = {}
    for text in given:
        name, _, ends = text.partition("=")
        try:
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            raise OptionError(f"--box {text}: write NAME=LOW:HIGH") from None
        found[name.strip()] = (low, high)
    if not found:
        raise OptionError("--box NAME=LOW:HIGH is needed, once for each coordinate")
    return found


def can_write(option: str, path: str | None) -> None:
    """Refuse before the run what could only fail after it."""
    if path is None:
        return
    if option == "--plot":
        need(option, HTML if is_page(path) else PLOT)
    elif option == "--save":
        need(option, FILES)
        require_netcdf(f"{option} {path}", path)
    if option == "--plot":
        require_writable(path, f"{option} ")
    if not Path(path).resolve().parent.is_dir():
        raise OptionError(f"{option} {path}: no such folder")
