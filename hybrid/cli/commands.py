"""The command line: ``hybrid run``, ``list``, ``check``, ``compare``, ``bench``,
``certify``, ``report``; the commands of maps are in :mod:`.maps`.

Exit codes: 0 done (``certify``: certified); 1 solvers differ by more than the tolerance
explains (``certify``: refuted); 2 something asked for cannot be done (one line says what);
3 ``certify`` could not decide; 130 interrupted, with what was computed until then reported.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import attrs
import typer

from .. import gallery
from ..errors import PLOT, DeclarationError, HybridError, OptionError, need
from ..result import Trajectory
from ..trajectory.stats import versions
from ..trajectory.trajectory import Status
from .given import asked, bounds, can_write, flown, pairs, tolerances
from .options import Json, ModelName, Parameters, Plot, Quiet, Reader, with_options
from .told import (
    PRINTED,
    as_json,
    bar,
    compared,
    differing,
    exact,
    facts,
    report_of,
    table,
    write_jumps,
)

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Simulate hybrid automata through Zeno points."
)


@contextmanager
def one_line() -> Iterator[None]:
    """Faults as one line on standard error and exit code 2."""
    try:
        yield
    except HybridError as fault:
        typer.echo(f"hybrid: {fault}", err=True)
        raise typer.Exit(2) from None


def _version(asked: bool) -> None:
    """Print the versions of all that computes, and end."""
    if asked:
        typer.echo("\n".join(f"{name} {number}" for name, number in versions().items()))
        raise typer.Exit()


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the versions of hybrid and what it computes with.",
        ),
    ] = False,
) -> None:
    """Simulate hybrid automata through Zeno points."""


@app.command()
@one_line()
@with_options(flown)
def run(
    options: Reader,
    plot: Plot = None,
    save: Annotated[str | None, typer.Option(help="Write the trajectory: out.nc.")] = None,
    table_: Annotated[
        str | None,
        typer.Option("--csv", help="Write the table of jumps: out.csv; - prints it alone."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed, for models that draw random numbers.")] = 0,
    oracle: Annotated[
        bool, typer.Option("--oracle", help="Compare with the exact values in the model's file.")
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run a model, say what happened, and draw or save it."""
    given = options()
    can_write("--plot", plot)
    can_write("--save", save)
    can_write("--csv", table_)
    if table_ == PRINTED and (json or oracle):
        raise OptionError("--csv - prints the table of jumps alone; leave out --json and --oracle")
    quiet |= table_ == PRINTED
    result = _simulate(*given.run, seed=seed, **given.options)
    rows = exact(given.entry, result) if oracle else []
    if json:
        known = [{"what": what, "computed": a, "exact": b} for what, a, b in rows]
        typer.echo(as_json({**facts(result), **({"oracle": known} if oracle else {})}))
    elif not quiet:
        report_of(result)
        if oracle:
            compared(rows)
    for what, path, write_it in (
        ("picture", plot, result.plot),
        ("trajectory", save, result.save),
        ("jumps", table_, partial(write_jumps, result)),
    ):
        if path is not None:
            write(partial(write_it, path))
            if not (quiet or json):
                typer.echo(f"{what}: {path}")
    if result.status is Status.INTERRUPTED:
        raise typer.Exit(130)


@app.command()
@one_line()
@with_options(asked)
def compare(
    options: Reader,
    rtol: Annotated[float, typer.Option(help="Relative tolerance, of all alike.")] = 1e-9,
    atol: Annotated[float, typer.Option(help="Absolute tolerance, of all alike.")] = 1e-11,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run a model with all solvers side by side: what differs, and what explains it."""
    from ..benchmark.agreement import compare as run_all

    given = options()
    found = run_all(*given.run, rtol=rtol, atol=atol, **given.options)
    if json:
        typer.echo(as_json(differing(found)))
    elif not quiet:
        table(found)
    if not found.explained:
        raise typer.Exit(1)


@app.command()
@one_line()
@with_options(asked)
def bench(
    options: Reader,
    solvers: Annotated[
        str | None, typer.Option(help="scipy:DOP853,taylor,diffrax:Tsit5 ...; these are a few.")
    ] = None,
    rtol: Annotated[
        str, typer.Option(help="Tolerances: 1e-4,1e-8, or 1e-4..1e-12, one for each power of ten.")
    ] = "1e-4,1e-6,1e-8,1e-10,1e-12",
    repeats: Annotated[
        int, typer.Option(help="Rounds of timings, of which medians are taken.")
    ] = 7,
    out: Annotated[
        Path | None, typer.Option(help="A folder for the table, the figure and the numbers.")
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Speed against error on a model: several solvers at several tolerances, timed in turns.

    Errors are those of the exact values in the model's file; where it has none, or its run has been
    changed, those against a run of another method, accurate to rounding.
    """
    from ..benchmark import bench as measure
    from ..benchmark.precision import TIMED_SOLVERS

    if out is not None:
        need("--out", PLOT)
    given, said = options(), options.keywords
    changed = any(said[name] for name in ("set_", "start", "history"))
    changed |= said["since"] is not None or said["until"] is not None or said["memory"] != "keep"
    found = measure(
        *given.run,
        solvers=[name.strip() for name in solvers.split(",")] if solvers else TIMED_SOLVERS,
        rtol=tolerances(rtol),
        oracle=None if changed else getattr(given.entry.module, "oracle", None),
        repeats=repeats,
        progress=_say if sys.stderr.isatty() and not quiet else None,
        **given.options,
    )
    if json or not quiet:
        typer.echo(as_json(found.to_dict()) if json else str(found))
    if out is not None:
        name = Path(said["model"].partition(":")[0]).stem
        write(lambda: _keep(found, out, name))
        if not (quiet or json):
            typer.echo(f"table, figure, numbers: {out / name}.txt, .png, .json")


def _say(line: str) -> None:
    typer.echo(line, err=True)


def _keep(found: Any, out: Path, name: str) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.txt").write_text(f"{found}\n", encoding="utf-8")
    found.plot(out / f"{name}.png")
    found.save(out / f"{name}.json")


#: Exit codes of ``hybrid certify``.
VERDICTS = {"certified": 0, "refuted": 1, "undecided": 3}


@app.command()
@one_line()
def certify(
    model: ModelName,
    box: Annotated[
        list[str] | None,
        typer.Option(help="Bounds: x=2:2.5, v=-7:7; or gap=0:1, speed=0:1, t=0:9. Repeat it."),
    ] = None,
    set_: Parameters = None,
    mode: Annotated[str | None, typer.Option(help="The mode that the contact is in.")] = None,
    contact: Annotated[str | None, typer.Option(help="Which contact, if several.")] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Prove that impacts accumulate: exit code 0 certified, 1 refuted, 3 undecided."""
    from ..certificates import certify as prove

    made = gallery.find(model).cls(**pairs(set_ or [], "--set"))
    found = prove(made, bounds(box or []), mode, contact)
    if json or not quiet:
        typer.echo(as_json(attrs.asdict(found)) if json else str(found))
    if VERDICTS[found.verdict]:
        raise typer.Exit(VERDICTS[found.verdict])


@app.command("list")
def list_(quiet: Quiet = False, json: Json = False) -> None:
    """The models of the gallery."""
    known = {name: gallery.summary(name) for name in gallery.names()}
    if json:
        typer.echo(as_json(known))
    elif not quiet:
        for name, summary in known.items():
            typer.echo(f"{name:16} {summary}")


@app.command()
@one_line()
def check(
    file: Annotated[str, typer.Argument(help="FILE.py, or a name in the gallery.")],
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Check a model's declaration: all its faults, or what it declares."""
    from ..automaton.past import blank
    from ..lowering import Scene
    from ..lowering.taylor import flat

    try:
        cls = gallery.find(file).cls
        spec = cls.spec
        values = [parameter.default for parameter in spec.parameters]
        shapes = tuple(getattr(value, "shape", ()) for value in values)
        windows = blank(spec.lags, spec.dimension)
        scene = Scene(cls, shapes, tuple(flat([*values, *windows])))
        for name in scene.modes:
            scene.field(name)
    except DeclarationError as fault:
        typer.echo(str(fault), err=True)
        raise typer.Exit(2) from None
    declared = {
        "states": spec.names,
        "modes": list(scene.modes),
        "edges": list(dict.fromkeys(edge.name for edge in spec.transitions)),
        "lags": [lag.name for lag in spec.lags],
    }
    if json:
        typer.echo(as_json({"model": spec.model, **declared}))
    elif not quiet:
        words = [f"{what} {', '.join(names) or 'none'}" for what, names in declared.items()]
        said = "; ".join(words if spec.lags else words[:-1])
        typer.echo(f"{spec.model}: no faults. S{said[1:]}.")


@app.command()
@one_line()
def report(
    out: Annotated[Path, typer.Option(help="A folder for the page and its pictures.")],
    only: Annotated[
        list[str] | None, typer.Option(help="A section: existence, beam ... May be repeated.")
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Reproduce the paper *Analysis of Impact Chattering*: a page of claims and verdicts."""
    judged: list[Any] = []
    tell = partial(_judged, judged, quiet or json)
    path = gallery.paper().report(out, only or [], tell)
    if json:
        typer.echo(as_json({"page": str(path), "claims": judged}))
    elif not quiet:
        typer.echo(f"page: {path}")


def _judged(judged: list[Any], silent: bool, section: Any, seconds: float) -> None:
    """Keep the verdicts of one section of the report, and say them."""
    if not silent:
        typer.echo(f"{section.title} ({seconds:.0f} s)")
    for claim in section.claims:
        verdict = claim.verdict.value
        judged.append({"place": claim.place, "verdict": verdict, "found": claim.found})
        if not silent:
            typer.echo(f"  {verdict:14} {claim.place}: {claim.found}")


def _simulate(model: Any, start: Any, span: tuple[float, float], **options: Any) -> Trajectory:
    from ..simulation import simulate

    if not sys.stderr.isatty():
        return simulate(model, start, span, **options)
    with bar(span) as progress:
        return simulate(model, start, span, progress=progress, **options)


def write(action: Callable[[], Any]) -> None:
    """Write a file, or say why it cannot be written."""
    try:
        action()
    except (OSError, ValueError) as fault:
        raise OptionError(str(fault)) from None


if __name__ == "__main__":
    app()
