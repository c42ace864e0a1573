"""The options that several commands have, and how a command comes to have them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any

import typer

ModelName = Annotated[str, typer.Argument(help="A name in the gallery, FILE.py, or FILE.py:Class.")]
Parameters = Annotated[
    list[str] | None, typer.Option("--set", help="A parameter: r=0.8. May be repeated.")
]
States = Annotated[list[str] | None, typer.Option("--start", help="A state at the start: x=1.9.")]
Since = Annotated[float | None, typer.Option("--from", help="First time.")]
Until = Annotated[float | None, typer.Option("--until", help="Last time.")]
Before = Annotated[
    list[str] | None, typer.Option("--history", help="A state before the start: x=0. For delays.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but faults.")]
Json = Annotated[bool, typer.Option("--json", help="Print what is found as JSON.")]
SolverName = Annotated[str, typer.Option("--solver", help="scipy, diffrax or taylor.")]
MethodName = Annotated[
    str | None, typer.Option("--method", help="A method of the solver: DOP853, RK45, Tsit5 ...")
]
Relative = Annotated[
    float | None, typer.Option("--rtol", help="Relative tolerance; the solver's own if omitted.")
]
Absolute = Annotated[
    float | None, typer.Option("--atol", help="Absolute tolerance; the solver's own if omitted.")
]
LongestStep = Annotated[float | None, typer.Option("--max-step", help="The longest step, in time.")]
FirstStep = Annotated[
    float | None,
    typer.Option("--first-step", help="The first step tried at the start and after each jump."),
]
Choice = Annotated[
    str, typer.Option("--zeno", help="At an accumulation: rest, stop, truncate, raise or ignore.")
]
ModeAtStart = Annotated[str | None, typer.Option("--mode", help="Mode at the start.")]
MostJumps = Annotated[
    int | None,
    typer.Option(
        "--max-jumps", help="Stop after this many computed jumps; with truncate: impacts a series."
    ),
]
MemoryKind = Annotated[str, typer.Option("--memory", help="keep or restart. For delays.")]
Plot = Annotated[
    str | None, typer.Option("--plot", help="Write a picture: out.png, out.pdf, out.svg, out.html.")
]

#: What reads the options that commands share.
Reader = partial[Any]


def with_options(reader: Callable[..., Any]) -> Callable[..., Callable[..., Any]]:
    """Give a command the options of a reader, and as its first argument what reads them.

    Its own options follow; one of the same name takes the place of the reader's.
    """

    def decorated(command: Callable[..., Any]) -> Callable[..., Any]:
        shared = signature(reader, eval_str=True).parameters
        _, *own = signature(command, eval_str=True).parameters.values()
        all_ = {**shared, **{each.name: each for each in own}}

        @wraps(command)
        def told(**given: Any) -> Any:
            common = {name: given.pop(name) for name in shared}
            return command(partial(reader, **common), **given)

        options = [each.replace(kind=Parameter.KEYWORD_ONLY) for each in all_.values()]
        told.__signature__ = Signature(options)  # type: ignore[attr-defined]
        told.__annotations__ = {each.name: each.annotation for each in options}
        return told

    return decorated
