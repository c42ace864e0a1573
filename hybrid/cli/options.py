"""The options that several commands have."""

from __future__ import annotations

from typing import Annotated

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
