"""``hybrid sweep``, ``basins``, ``bifurcation``, ``region``: maps from the command line."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import attrs
import numpy as np
import typer

from ..automaton import EITHER, FALLING, RISING
from ..automaton.outputs import require_outputs
from ..errors import OptionError
from .commands import app, one_line, write
from .given import bounds, can_write, flown, values
from .options import Json, Plot, Quiet, Reader, with_options
from .told import as_json, bar

if TYPE_CHECKING:
    from collections.abc import Iterator

Over = Annotated[
    list[str] | None,
    typer.Option(help="r=0.3:0.9:40, or r=[0.3,0.5]; a parameter, or a state's start."),
]
Solver = Annotated[str | None, typer.Option(help="scipy, diffrax or taylor.")]
Measure = Annotated[
    list[str] | None, typer.Option(help="An output, stick, period or lyapunov. May be repeated.")
]
Section = Annotated[
    str | None,
    typer.Option(help="A jump's name; a period; or v=0, where a state has a value: points there."),
]
Crossing = Annotated[str, typer.Option(help="Of v=0: rising, falling or either.")]
Skip = Annotated[int, typer.Option(help="Points on the section to pass over.")]
Keep = Annotated[int, typer.Option(help="Points to keep at most.")]
Kept = Annotated[
    str | None, typer.Option("--store", help="Where blocks are kept as they are done: map.zarr.")
]
Save = Annotated[str | None, typer.Option(help="Write the map: out.nc.")]

CROSSINGS = {"rising": RISING, "falling": FALLING, "either": EITHER}


@attrs.frozen
class _Asked:
    """A map as the options say it."""

    model: Any
    axes: dict[str, Any]
    start: dict[str, Any]
    span: tuple[float, float]
    options: dict[str, Any]
    save: str | None

    def require_section(self) -> None:
        """Refuse a map of points on a section without one."""
        if self.options["section"] is None:
            raise OptionError("--section is needed: a jump's name, a period, or v=0")

    def write(self, table: Any) -> None:
        """Write the table of lanes, if that is asked."""
        if self.save is not None:
            write(partial(table.to_netcdf, self.save, engine="h5netcdf"))

    def fly(self, how: Callable[..., Any], **more: Any) -> Any:
        """Call what makes a map; interrupted, say where what is done is kept."""
        given = self.model, self.axes, self.start, self.span
        try:
            with self.progress() as progress:
                return how(*given, progress=progress, **self.options, **more)
        except KeyboardInterrupt:
            store = self.options["store"]
            left = f"; what is done is in {store}" if store else ""
            typer.echo(f"hybrid: interrupted{left}", err=True)
            raise typer.Exit(130) from None

    @contextmanager
    def progress(self) -> Iterator[Callable[[int, int], None] | None]:
        """A bar, where somebody looks."""
        if not sys.stderr.isatty():
            yield None
            return
        with bar((0.0, math.prod(len(row) for row in self.axes.values()))) as told:
            yield lambda done, _: told(done)


@with_options(flown)
def _common(
    options: Reader,
    over: Over = None,
    solver: Solver = None,
    section: Section = None,
    crossing: Crossing = "rising",
    store: Kept = None,
    save: Save = None,
) -> _Asked:
    """The map that the options say which all maps have."""
    can_write("--save", save)
    axes = values(over or [])
    first = [f"{name}=0" for name in axes]  # a state that is swept needs no start
    given = partial(options, start=[*(options.keywords["start"] or []), *first])()
    made, begun, span = given.run
    begun = {name: value for name, value in begun.items() if name not in axes}
    asked = given.options | {"store": store} | _section(section, crossing)
    return _Asked(made, axes, begun, span, asked, save)


#: What gives a command the options that all maps have.
_of_maps = with_options(_common)


def _section(section: str | None, crossing: str) -> dict[str, Any]:
    """A section as options of an ensemble."""
    if crossing not in CROSSINGS:
        raise OptionError(f"--crossing {crossing}: {', '.join(CROSSINGS)}")
    name, equals, level = (section or "").partition("=")
    try:
        if equals:
            at = _Level(name.strip(), float(level))
            return {"section": at, "crossing": CROSSINGS[crossing]}
        return {"section": section if section is None else float(section)}
    except ValueError:
        if equals:
            raise OptionError(f"--section {section}: write NAME=NUMBER") from None
        return {"section": section}


@attrs.frozen
class _Level:
    """The surface on which a state has a value."""

    name: str
    level: float

    def __call__(self, model: Any, t: Any, s: Any) -> Any:
        return getattr(s, self.name) - self.level


@app.command()
@one_line()
@_of_maps
def sweep(
    common: Reader,
    model: Annotated[str | None, typer.Argument(help="As for run; none with --status.")] = None,
    measure: Measure = None,
    skip: Skip = 0,
    keep: Keep = 32,
    status: Annotated[
        str | None, typer.Option(help="Say how far the map is that is stored there.")
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run a model over a grid of parameters and starts; with --store it can be gone on with."""
    from ..maps import sweep as fly
    from ..maps.store import status as stored

    if status is not None:
        found = stored(status)
        if json or not quiet:
            typer.echo(as_json(found) if json else _how_far(found))
        return
    if common.keywords["model"] is None:
        raise OptionError("hybrid sweep MODEL --over NAME=FROM:TO:COUNT, or --status map.zarr")
    given = common()
    table = given.fly(fly, measure=measure or [], skip=skip, keep=keep)
    _tell(table, json, quiet)
    given.write(table)


@app.command()
@one_line()
@_of_maps
def basins(
    common: Reader,
    keep: Keep = 100,
    near: Annotated[float, typer.Option(help="One place, as a share of what is spanned.")] = 0.01,
    plot: Plot = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """To which attractor each start leads: rest, or an orbit; and a picture of it."""
    from ..maps import basins as find

    can_write("--plot", plot)
    given = common()
    given.require_section()
    found = given.fly(find, keep=keep, near=near)
    if json:
        rows = [attrs.asdict(each) for each in found.attractors]
        for row in rows:
            row["state"] = {name: row["state"][name] for name in row["state"].keys()}
        typer.echo(as_json({"attractors": rows, "none": found.none}))
    elif not quiet:
        typer.echo(str(found))
    given.write(found.table)
    _draw(found.plot, plot, json or quiet)


@app.command()
@one_line()
@_of_maps
def bifurcation(
    common: Reader,
    state: Annotated[str, typer.Argument(help="The state, or output, that is drawn.")],
    skip: Skip = 100,
    keep: Keep = 50,
    follow: Annotated[
        bool, typer.Option("--follow", help="Begin each value where the one before has ended.")
    ] = False,
    plot: Plot = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Points on a section over a parameter, once transients have died away; and a picture."""
    from ..maps import bifurcation as find

    can_write("--plot", plot)
    given = common()
    given.require_section()
    own = require_outputs(given.model.spec, [state])
    found = given.fly(find, measure=["period", *own], skip=skip, keep=keep, follow=follow)
    _tell(found.table, json, quiet)
    given.write(found.table)
    _draw(partial(found.plot, state), plot, json or quiet)


@app.command()
@one_line()
@_of_maps
def region(
    common: Reader,
    by: Annotated[str, typer.Option(help="The column: verdict, mode, status, period.")] = "verdict",
    box: Annotated[
        list[str] | None,
        typer.Option(help="What is proved is drawn over it: bounds as for certify. Repeat it."),
    ] = None,
    measure: Measure = None,
    skip: Skip = 0,
    keep: Keep = 32,
    plot: Plot = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """A plane by what becomes of each lane, and what is proved of it; and a picture."""
    from ..maps import region as find

    can_write("--plot", plot)
    given = common()
    options = {"measure": measure or [], "skip": skip, "keep": keep, "by": by}
    found = given.fly(find, **options, box=bounds(box) if box else None)
    _tell(found.table, json, quiet)
    given.write(found.table)
    _draw(found.plot, plot, json or quiet)


def _tell(table: Any, json: bool, quiet: bool) -> None:
    """How many lanes there are, and how they ended."""
    names, counts = np.unique(table.status.values, return_counts=True)
    told = dict(zip(names.tolist(), counts.tolist(), strict=True))
    if json:
        typer.echo(as_json({"lanes": int(counts.sum()), "status": told}))
    elif not quiet:
        ends = ", ".join(f"{count} {name}" for name, count in told.items())
        typer.echo(f"{table.attrs['model']}: {counts.sum()} lanes: {ends}")


def _how_far(found: dict[str, Any]) -> str:
    """How far a stored map is."""
    said = "{model}: {done} of {blocks} blocks are done, {lanes} lanes in all".format(**found)
    if found["pace"]:
        said += f"; {found['pace']:.3g} lanes a second"
    for what in ("status", "verdict"):
        ends = ", ".join(f"{count} {name or 'none'}" for name, count in found[what].items())
        said += f"\n  {what}: {ends}" if ends else ""
    return said


def _draw(draw: Callable[[str], Any], path: str | None, silent: bool) -> None:
    if path is not None:
        write(partial(draw, path))
        if not silent:
            typer.echo(f"picture: {path}")
