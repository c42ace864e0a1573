"""The command line: ``hybrid run``, ``list``, ``check``, ``compare``, ``bench``,
``certify``, ``report``.

Exit codes: 0 done (``certify``: certified); 1 solvers differ by more than the tolerance
explains (``certify``: refuted); 2 something asked for cannot be done (one line says what);
3 ``certify`` could not decide; 130 interrupted, with what was computed until then reported.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from .. import gallery
from ..errors import FILES, HTML, PLOT, DeclarationError, HybridError, OptionError, StartError, need
from ..plot import is_page
from ..result import Trajectory
from ..trajectory.stats import versions
from ..trajectory.trajectory import Status

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Simulate hybrid automata through Zeno points."
)

#: Accumulations that are printed, at most.
PRINTED_LIMITS = 20

#: Seconds after which a run shows its progress.
SILENT_SECONDS = 1.0


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
MemoryKind = Annotated[str, typer.Option("--memory", help="keep or restart. For delays.")]


@contextmanager
def _one_line() -> Iterator[None]:
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
        typer.Option("--version", callback=_version, is_eager=True, help="Say the versions."),
    ] = False,
) -> None:
    """Simulate hybrid automata through Zeno points."""


@app.command()
def run(
    model: ModelName,
    set_: Parameters = None,
    start: States = None,
    since: Since = None,
    until: Until = None,
    history: Before = None,
    memory: MemoryKind = "keep",
    solver: Annotated[str, typer.Option(help="scipy, diffrax or taylor.")] = "scipy",
    method: Annotated[
        str | None, typer.Option(help="A method of the solver: DOP853, RK45 ...")
    ] = None,
    rtol: Annotated[
        float | None, typer.Option(help="Relative tolerance; the solver's own if omitted.")
    ] = None,
    atol: Annotated[
        float | None, typer.Option(help="Absolute tolerance; the solver's own if omitted.")
    ] = None,
    max_step: Annotated[float | None, typer.Option(help="The longest step, in time.")] = None,
    first_step: Annotated[
        float | None, typer.Option(help="The first step after the start and after each jump.")
    ] = None,
    zeno: Annotated[str, typer.Option(help="rest, stop, truncate or raise.")] = "rest",
    mode: Annotated[str | None, typer.Option(help="Mode at the start.")] = None,
    max_jumps: Annotated[
        int | None,
        typer.Option(help="Stop after so many computed jumps; impacts permitted with truncate."),
    ] = None,
    plot: Annotated[
        str | None, typer.Option(help="Write a picture: out.png, out.pdf, out.svg, out.html.")
    ] = None,
    save: Annotated[str | None, typer.Option(help="Write the trajectory: out.nc.")] = None,
    oracle: Annotated[
        bool, typer.Option("--oracle", help="Compare with the exact values in the model's file.")
    ] = False,
) -> None:
    """Run a model, say what happened, and draw or save it."""
    with _one_line():
        entry = gallery.find(model)
        _can_write("--plot", plot)
        _can_write("--save", save)
        values = _pairs(set_ or [], "--set")
        made = entry.cls(**values)
        first = _start(entry, _pairs(start or [], "--start"))
        span = _span(entry, since, until)
        result = _simulate(
            made,
            first,
            span,
            solver=solver,
            method=method,
            rtol=rtol,
            atol=atol,
            max_step=max_step,
            first_step=first_step,
            zeno=zeno,
            mode=mode,
            max_jumps=max_jumps,
            history=_history(entry, _pairs(history or [], "--history")),
            memory=memory,
        )
        _report(result)
        if oracle:
            _compare(entry, result)
        if plot is not None:
            _write(lambda: result.plot(plot))
            typer.echo(f"picture: {plot}")
        if save is not None:
            _write(lambda: result.save(save))
            typer.echo(f"trajectory: {save}")
    if result.status is Status.INTERRUPTED:
        raise typer.Exit(130)


@app.command()
def compare(
    model: ModelName,
    set_: Parameters = None,
    start: States = None,
    since: Since = None,
    until: Until = None,
    history: Before = None,
    memory: MemoryKind = "keep",
    rtol: Annotated[float, typer.Option(help="Relative tolerance, of all alike.")] = 1e-9,
    atol: Annotated[float, typer.Option(help="Absolute tolerance, of all alike.")] = 1e-11,
) -> None:
    """Run a model with all solvers side by side: what differs, and what explains it."""
    from ..benchmark.agreement import compare as run_all

    with _one_line():
        entry = gallery.find(model)
        made = entry.cls(**_pairs(set_ or [], "--set"))
        first = _start(entry, _pairs(start or [], "--start"))
        found = run_all(
            made,
            first,
            _span(entry, since, until),
            rtol=rtol,
            atol=atol,
            history=_history(entry, _pairs(history or [], "--history")),
            memory=memory,
        )
    _table(found)
    if not found.explained:
        raise typer.Exit(1)


@app.command()
def bench(
    model: ModelName,
    set_: Parameters = None,
    start: States = None,
    since: Since = None,
    until: Until = None,
    history: Before = None,
    memory: MemoryKind = "keep",
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
) -> None:
    """Speed against error on a model: several solvers at several tolerances, timed in turns.

    Errors are those of the exact values in the model's file; where it has none, or its run has been
    changed, those against a run of another method, accurate to rounding.
    """
    from ..benchmark import bench as measure
    from ..benchmark.precision import TIMED_SOLVERS

    with _one_line():
        if out is not None:
            need("--out", PLOT)
        entry = gallery.find(model)
        values, first = _pairs(set_ or [], "--set"), _pairs(start or [], "--start")
        before = _pairs(history or [], "--history")
        spans = since is not None or until is not None
        own = not (values or first or before or spans or memory != "keep")
        found = measure(
            entry.cls(**values),
            _start(entry, first),
            _span(entry, since, until),
            solvers=[name.strip() for name in solvers.split(",")] if solvers else TIMED_SOLVERS,
            rtol=_tolerances(rtol),
            oracle=getattr(entry.module, "oracle", None) if own else None,
            repeats=repeats,
            progress=_say if sys.stderr.isatty() else None,
            history=_history(entry, before),
            memory=memory,
        )
        typer.echo(str(found))
        if out is not None:
            name = Path(model.partition(":")[0]).stem
            _write(lambda: _keep(found, out, name))
            typer.echo(f"table, figure, numbers: {out / name}.txt, .png, .json")


def _say(line: str) -> None:
    typer.echo(line, err=True)


def _keep(found: Any, out: Path, name: str) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.txt").write_text(f"{found}\n", encoding="utf-8")
    found.plot(out / f"{name}.png")
    found.save(out / f"{name}.json")


def _tolerances(text: str) -> list[float]:
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


def _table(found: Any) -> None:
    """Each quantity's largest difference from the reference, and what is explained."""
    from ..benchmark.agreement import CLOSE_QUANTITIES, ERROR_STEPS, SAME_QUANTITIES

    for label, run in found.runs.items():
        if isinstance(run, HybridError):
            typer.echo(f"{label:18} failed: {run}")
        else:
            typer.echo(f"{label:18} {len(run.own_jumps)} jumps computed, {len(run.zeno)} summed")
    if not found.differences:
        return
    typer.echo(f"largest differences from {found.reference}:")
    for quantity in SAME_QUANTITIES:
        worst = found.worst(quantity)
        typer.echo(f"{quantity:10} {'the same' if worst.explained else 'NOT the same'}")
    for quantity in CLOSE_QUANTITIES:
        worst, growth = found.worst(quantity), found.growth[quantity]
        verdict = "explained by" if worst.explained else "NOT explained by"
        typer.echo(
            f"{quantity:10} {worst.size:9.1e}  {worst.method:16} {verdict} {worst.allowed:.1e} "
            f"= {ERROR_STEPS} steps of rtol {found.rtol:g}, grown {growth:.3g}"
        )


#: Exit codes of ``hybrid certify``.
VERDICTS = {"certified": 0, "refuted": 1, "undecided": 3}


@app.command()
def certify(
    model: ModelName,
    box: Annotated[
        list[str] | None,
        typer.Option(help="Bounds: x=2:2.5, v=-7:7; or gap=0:1, speed=0:1, t=0:9. Repeat it."),
    ] = None,
    set_: Parameters = None,
    mode: Annotated[str | None, typer.Option(help="The mode that the contact is in.")] = None,
    contact: Annotated[str | None, typer.Option(help="Which contact, if several.")] = None,
) -> None:
    """Prove that impacts accumulate: exit code 0 certified, 1 refuted, 3 undecided."""
    from ..certificates import certify as prove

    with _one_line():
        made = gallery.find(model).cls(**_pairs(set_ or [], "--set"))
        found = prove(made, _bounds(box or []), mode, contact)
    typer.echo(str(found))
    if VERDICTS[found.verdict]:
        raise typer.Exit(VERDICTS[found.verdict])


def _bounds(given: list[str]) -> dict[str, tuple[float, float]]:
    bounds = {}
    for text in given:
        name, _, ends = text.partition("=")
        try:
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            raise OptionError(f"--box {text}: write NAME=LOW:HIGH") from None
        bounds[name.strip()] = (low, high)
    if not bounds:
        raise OptionError("--box NAME=LOW:HIGH is needed, once for each coordinate")
    return bounds


@app.command("list")
def list_() -> None:
    """The models of the gallery."""
    for name in gallery.names():
        typer.echo(f"{name:16} {gallery.summary(name)}")


@app.command()
def check(file: Annotated[str, typer.Argument(help="FILE.py, or a name in the gallery.")]) -> None:
    """Check a model's declaration: all its faults, or what it declares."""
    from ..automaton.past import blank
    from ..lowering import Scene
    from ..lowering.taylor import flat

    with _one_line():
        try:
            entry = gallery.find(file)
            spec = entry.cls.spec
            values = [parameter.default for parameter in spec.parameters]
            shapes = tuple(getattr(value, "shape", ()) for value in values)
            windows = blank(spec.lags, spec.dimension)
            scene = Scene(entry.cls, shapes, tuple(flat([*values, *windows])))
            for name in scene.modes:
                scene.field(name)
        except DeclarationError as fault:
            typer.echo(str(fault), err=True)
            raise typer.Exit(2) from None
    edges = ", ".join(dict.fromkeys(edge.name for edge in spec.transitions)) or "none"
    modes = ", ".join(scene.modes)
    states = ", ".join(spec.names)
    lags = "; lags " + ", ".join(lag.name for lag in spec.lags) if spec.lags else ""
    typer.echo(f"{spec.model}: no faults. States {states}; modes {modes}; edges {edges}{lags}.")


@app.command()
def report(
    out: Annotated[Path, typer.Option(help="A folder for the page and its pictures.")],
    only: Annotated[
        list[str] | None, typer.Option(help="A section: existence, beam ... May be repeated.")
    ] = None,
) -> None:
    """Reproduce the paper *Analysis of Impact Chattering*: a page of claims and verdicts."""
    with _one_line():
        path = gallery.paper().report(out, only or [], _judged)
    typer.echo(f"page: {path}")


def _judged(section: Any, seconds: float) -> None:
    """The verdicts of one section of the report."""
    typer.echo(f"{section.title} ({seconds:.0f} s)")
    for claim in section.claims:
        typer.echo(f"  {claim.verdict.value:14} {claim.place}: {claim.found}")


def _pairs(given: list[str], option: str) -> dict[str, Any]:
    pairs = {}
    for text in given:
        name, equals, value = text.partition("=")
        try:
            pairs[name.strip()] = json.loads(value)
        except json.JSONDecodeError:
            equals = ""
        if not equals:
            raise OptionError(f"{option} {text}: write NAME=NUMBER, or NAME=[NUMBER,NUMBER]")
    return pairs


def _start(entry: gallery.GalleryEntry, given: dict[str, Any]) -> dict[str, Any]:
    start = {**(entry.start or {}), **given}
    missing = [name for name in entry.cls.spec.names if name not in start]
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


def _simulate(model: Any, start: Any, span: tuple[float, float], **options: Any) -> Trajectory:
    from ..simulation import simulate

    if not sys.stderr.isatty():
        return simulate(model, start, span, **options)
    with _bar(span) as progress:
        return simulate(model, start, span, progress=progress, **options)


@contextmanager
def _bar(span: tuple[float, float]) -> Iterator[Callable[[float], None]]:
    """A progress bar that appears once the run has taken a second."""
    from rich.console import Console
    from rich.progress import Progress

    begun = time.monotonic()
    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task("simulating", total=span[1] - span[0])

    def progress(t: float) -> None:
        if time.monotonic() - begun > SILENT_SECONDS:
            bar.start()
            bar.update(task, completed=t - span[0])

    try:
        yield progress
    finally:
        bar.stop()


def _report(result: Trajectory) -> None:
    parameters = ", ".join(f"{k}={v}" for k, v in result.parameters.items())
    typer.echo(
        f"{result.spec.model}({parameters}), {result.options['solver']} {result.options['method']}"
    )
    typer.echo(f"{len(result.jumps)} jumps listed; t = {result.t0:.12g} to {result.t1:.12g}")
    for point in result.zeno[:PRINTED_LIMITS]:
        if point.truncation is None:
            _ = point.t_error, point.verdict  # looked for here: the line tells them
        typer.echo(f"  {point}")
        if point.t_release is not None:
            typer.echo(f"    released at t = {point.t_release!r}")
    if len(result.zeno) > PRINTED_LIMITS:
        typer.echo(f"  ... and {len(result.zeno) - PRINTED_LIMITS} more accumulations")
    for graze in result.grazings:
        typer.echo(f"  grazing of {graze.edge} at t = {graze.t!r}")
    typer.echo(f"final: {result.final} in {result.mode}")
    typer.echo(str(result.status))


def _compare(entry: gallery.GalleryEntry, result: Trajectory) -> None:
    """Values of a run beside the exact ones."""
    if not hasattr(entry.module, "oracle"):
        raise OptionError(f"{entry.cls.__name__}: its file has no oracle(run)")
    try:
        rows = [(what, float(a), float(b)) for what, a, b, _ in entry.module.oracle(result)]
    except Exception as fault:  # whatever the user's function raises, in one line
        name = type(fault).__name__
        raise OptionError(f"oracle(run) of {entry.cls.__name__}: {name}: {fault}") from fault
    typer.echo(f"{'':28} {'computed':>22} {'exact':>22} {'difference':>11}")
    for what, value, exact in rows:
        typer.echo(f"{what:28} {value:22.15g} {exact:22.15g} {value - exact:11.1e}")


def _can_write(option: str, path: str | None) -> None:
    """Refuse before the run what could only fail after it."""
    if path is None:
        return
    if option == "--save":
        need(option, FILES)
    else:
        need(option, HTML if is_page(path) else PLOT)
    if option == "--plot" and not _drawable(path):
        raise OptionError(f"{option} {path}: end the name in .png, .pdf, .svg or .html")
    if not Path(path).resolve().parent.is_dir():
        raise OptionError(f"{option} {path}: no such folder")


def _drawable(path: str) -> bool:
    """Whether the end of a picture's name says in which format it is drawn."""
    if is_page(path):
        return True
    from matplotlib.backend_bases import FigureCanvasBase

    return Path(path).suffix.lower()[1:] in FigureCanvasBase.get_supported_filetypes()


def _write(action: Callable[[], Any]) -> None:
    """Write a file, or say why it cannot be written."""
    try:
        action()
    except (OSError, ValueError) as fault:
        raise OptionError(str(fault)) from None


if __name__ == "__main__":
    app()
