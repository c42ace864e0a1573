"""What commands print: a run, its progress, values beside exact ones, solvers side by side."""

from __future__ import annotations

import csv
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from math import isfinite
from typing import Any

import attrs
import numpy as np
import typer

from .. import gallery
from ..errors import HybridError, OptionError
from ..result import Trajectory
from ..trajectory.trajectory import counted

#: Accumulations that are printed, at most.
PRINTED_LIMITS = 20

#: The path of a table that is printed.
PRINTED = "-"

#: Seconds after which a run shows its progress.
SILENT_SECONDS = 1.0


@contextmanager
def bar(span: tuple[float, float]) -> Iterator[Callable[[float], None]]:
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


def report_of(result: Trajectory) -> None:
    """What a run has come to."""
    parameters = ", ".join(f"{k}={v}" for k, v in result.parameters.items())
    typer.echo(
        f"{result.spec.model}({parameters}), {result.options['solver']} {result.options['method']}"
    )
    typer.echo(
        f"{counted(len(result.jumps), 'jump')} listed; t = {result.t0:.12g} to {result.t1:.12g}"
    )
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
    typer.echo(result.ending)


def facts(result: Trajectory) -> dict[str, Any]:
    """What :func:`report_of` prints, by name."""
    limits = []
    for point in result.zeno:
        cut = point.truncation is not None
        known: dict[str, Any] = {} if cut else {"t_error": point.t_error}
        known |= {"verdict": point.verdict, "ratio": point.ratio, "edges": point.edges}
        known |= {"mode": point.mode, "t_release": point.t_release}
        limits.append({"t": point.t, **known, "state": _named(point.state)})
    return {
        "model": result.spec.model,
        "parameters": result.parameters,
        "solver": result.options["solver"],
        "method": result.options["method"],
        "t0": result.t0,
        "t1": result.t1,
        "jumps": len(result.jumps),
        "zeno": limits,
        "grazings": [{"t": graze.t, "edge": graze.edge} for graze in result.grazings],
        "final": _named(result.final),
        "mode": result.mode,
        "status": result.status.name,
        "reason": str(result.status),
    }


def _named(record: Any) -> dict[str, Any]:
    return {name: record[name] for name in record.keys()}


def as_json(value: Any) -> str:
    """Facts as JSON; what is no number, or infinite, is null."""
    return json.dumps(_plain(value), indent=1, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def write_jumps(result: Trajectory, path: str) -> None:
    """The table of jumps as CSV, numbers with all their digits; ``path`` may be ``PRINTED``."""
    columns, printed = result.jumps.columns, nullcontext(sys.stdout)
    with printed if path == PRINTED else open(path, "w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        rows.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def exact(entry: gallery.GalleryEntry, result: Trajectory) -> list[tuple[str, float, float]]:
    """Values of a run beside the exact ones: what, computed, exact."""
    if not hasattr(entry.module, "oracle"):
        raise OptionError(f"{entry.cls.__name__}: its file has no oracle(run)")
    try:
        return [(what, float(a), float(b)) for what, a, b, _ in entry.module.oracle(result)]
    except Exception as fault:  # whatever the user's function raises, in one line
        name = type(fault).__name__
        raise OptionError(f"oracle(run) of {entry.cls.__name__}: {name}: {fault}") from fault


def compared(rows: list[tuple[str, float, float]]) -> None:
    """Values of a run beside the exact ones."""
    typer.echo(f"{'':28} {'computed':>22} {'exact':>22} {'difference':>11}")
    for what, value, exact in rows:
        typer.echo(f"{what:28} {value:22.15g} {exact:22.15g} {value - exact:11.1e}")


def differing(found: Any) -> dict[str, Any]:
    """What :func:`table` prints, by name."""
    runs = found.runs.items()
    rows = [{**attrs.asdict(each), "explained": each.explained} for each in found.differences]
    return {
        "reference": found.reference,
        "explained": found.explained,
        "rtol": found.rtol,
        "failed": {label: str(run) for label, run in runs if isinstance(run, HybridError)},
        "differences": rows,
    }


def table(found: Any) -> None:
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
