"""One task after another: who, how long, how far off.

    python benchmarks/measure.py [TASK ...] [--quick] [--json FOLDER]

A task (``tasks/``) is a model, what is known of it, and what is timed by name: solvers of this
package and peers (``peers/``). Each is called at several tolerances, all in turns, so that what
else the machine does falls on all of them; a call counts by the median of its turns, in seconds of
the process where one core works, of the clock where more do. Of each the table has the fastest that
keeps to the error asked for, and its time as a multiple of the best of this package: a peer at 3
takes three times as long. The first call is timed alone, and that of this package again in a
process of its own. What is not installed is named.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import attrs
import jax

#: Turns of all calls, at least and at most, and the seconds after which no turn is begun.
LEAST_TURNS, TURNS, ENOUGH = 3, 9, 8.0

#: Seconds that one timing takes at least: as many calls are made.
SHORTEST = 5e-3

#: Calls before the first turn, and the seconds after which there is no other: runs of this package
#: that are long have machine code of their own compiled meanwhile.
WARM_CALLS, WARMING = 6, 1.2

#: A call that takes longer is timed by no more turns than its first call.
SLOW = 3.0

Call = Callable[[], Any]


@attrs.frozen(kw_only=True)
class Task:
    """What is timed, and how it is judged.

    Attributes
    ----------
    title, text : str
        What is asked, and where its truth is from.
    unit : str
        What a time is divided by: "an impact", "a run".
    wanted : float
        The error that is asked for.
    ways : mapping of str to callable
        Of a tolerance (None: to rounding) a call; ImportError where something is not installed.
        Names of this package's begin with "hybrid".
    judge : callable
        Of what a call returns, and its tolerance: its error, how many units it has made, and how
        many it has lost.
    tolerances : sequence
    clock : callable
    floor : callable or None
        What cannot be spared: rows of what, how often, and the seconds of one.
    """

    title: str
    text: str
    unit: str
    wanted: float
    ways: Mapping[str, Callable[[float | None], Call]]
    judge: Callable[[Any, float | None], tuple[float, int, int]]
    tolerances: tuple[float | None, ...] = (1e-6, 1e-9, 1e-12, None)
    clock: Callable[[], float] = time.process_time
    floor: Callable[[], list[tuple[str, float, float]]] | None = None


@attrs.define(kw_only=True)
class Row:
    """One way at one tolerance; times are seconds of a unit."""

    who: str
    rtol: float | None
    first: float | None = None
    seconds: float | None = None
    low: float | None = None
    high: float | None = None
    error: float | None = None
    count: int = 0
    lost: int = 0
    reason: str = ""

    def keeps(self, wanted: float) -> bool:
        """Whether it is as exact as asked for."""
        return self.seconds is not None and not self.lost and (self.error or 0.0) <= wanted


def measured(task: Task, tell: Callable[[str], None]) -> list[Row]:
    """Every way at every tolerance."""
    rows, calls = [], []
    for who, make in task.ways.items():
        for rtol in task.tolerances:
            row = Row(who=who, rtol=rtol)
            call = begun(task, make, row, rtol is task.tolerances[0])
            rows.append(row)
            tell(f"{who} at {tolerance(rtol)}: {row.reason or f'error {row.error:.1e}'}")
            if call:
                calls.append((row, *call))
            elif row.reason.endswith("not installed"):
                break
    in_turns(task, calls)
    return rows


def begun(task: Task, make: Any, row: Row, first: bool) -> tuple[Call, int, list[float]] | None:
    """The first call: its time, its error, and how many calls make a timing."""
    begin = time.perf_counter()
    try:
        call = make(row.rtol)
        found = call()
        took = time.perf_counter() - begin
        error, row.count, row.lost = task.judge(found, row.rtol)
    except ImportError as fault:
        row.reason = f"{fault.name} is not installed"
        return None
    except Exception as fault:  # what a tool raises is a row of the table
        row.reason = f"{type(fault).__name__}: {str(fault).splitlines()[0][:80]}"
        return None
    row.error = float(error) if math.isfinite(error) else None
    row.first = took if first else None
    if not math.isfinite(error) or not row.count:
        row.reason = "not the motion that is asked for"
        return None
    end = time.perf_counter() + WARMING
    for _ in range(WARM_CALLS):
        begin = task.clock()
        call()
        again = max(task.clock() - begin, 1e-9)
        if time.perf_counter() > end:
            break
    samples = [again / row.count] if again > SLOW else []
    return call, max(1, math.ceil(SHORTEST / again)), samples


def in_turns(task: Task, calls: list[tuple[Row, Call, int, list[float]]]) -> None:
    """Time the calls in turns."""
    end = time.perf_counter() + ENOUGH
    for turn in range(TURNS):
        if turn >= LEAST_TURNS and time.perf_counter() > end:
            break
        for row, call, number, samples in calls:
            if samples and samples[0] * row.count > SLOW:
                continue
            begin = task.clock()
            for _ in range(number):
                call()
            samples.append((task.clock() - begin) / number / row.count)
    for row, _, _, samples in calls:
        row.seconds = statistics.median(samples)
        row.low, row.high = min(samples), max(samples)


def best(rows: list[Row], wanted: float) -> dict[str, Row]:
    """Of each way the fastest that keeps to the error; the most exact where none does."""
    found: dict[str, Row] = {}
    for row in rows:
        known = found.get(row.who)
        if known is None or rank(row, wanted) < rank(known, wanted):
            found[row.who] = row
    return found


def rank(row: Row, wanted: float) -> tuple[int, float]:
    if row.keeps(wanted):
        return 0, row.seconds or 0.0
    if row.seconds is not None and not row.lost:
        return 1, row.error or 0.0
    return (2, row.error or 0.0) if row.seconds is not None else (3, 0.0)


def reference(rows: list[Row], wanted: float) -> Row | None:
    """The fastest of this package."""
    ours = [r for r in best(rows, wanted).values() if r.who.startswith("hybrid")]
    timed = [r for r in ours if r.seconds is not None]
    return min(timed, key=lambda row: rank(row, wanted), default=None)


def tolerance(rtol: float | None) -> str:
    return "rounding" if rtol is None else f"{rtol:.0e}"


def shown(seconds: float | None) -> str:
    """A time in a unit that fits."""
    if seconds is None:
        return ""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return "0"


def table(rows: list[Row], task: Any) -> str:
    """In Markdown."""
    ours = reference(rows, task.wanted)
    lines = [
        f"| who | rtol | first call | {task.unit} | ratio | error | |",
        "|---|---|---|---|---|---|---|",
    ]
    for who, row in best(rows, task.wanted).items():
        if row.seconds is None:
            lines.append(f"| {who} | | | | | | {row.reason} |")
            continue
        first = next((r.first for r in rows if r.who == who and r.first is not None), None)
        ratio = f"{row.seconds / ours.seconds:.3g}" if ours and ours.seconds else ""
        notes = [f"{row.lost} lost"] if row.lost else []
        notes += [] if row.keeps(task.wanted) or row.lost else ["not as exact as asked for"]
        cells = [who, tolerance(row.rtol), shown(first), shown(row.seconds), ratio]
        error = "" if row.error is None else f"{row.error:.0e}"
        lines.append(f"| {' | '.join(cells)} | {error} | {', '.join(notes)} |")
    return "\n".join(lines)


def floor_of(task: Task, rows: list[Row]) -> dict[str, Any] | None:
    """The least time that the work takes, beside what was measured."""
    ours = reference(rows, task.wanted)
    if task.floor is None or ours is None or ours.seconds is None:
        return None
    parts = task.floor()
    seconds = sum(number * each for _, number, each in parts)
    return {"parts": parts, "seconds": seconds, "measured": ours.seconds * ours.count}


def floor_text(floor: dict[str, Any]) -> str:
    parts = [
        f"{number:,.0f} {what} of {shown(each)}" for what, number, each in floor["parts"] if number
    ]
    share = floor["measured"] / floor["seconds"]
    return (
        f"Floor: {', '.join(parts)}: {shown(floor['seconds'])}; "
        f"measured {shown(floor['measured'])}, {share:.3g} times as much."
    )


def again(name: str, quick: bool) -> float | None:
    """Seconds of the first call in a process of its own, after others have made it."""
    call = [sys.executable, __file__, name, "--first", *(["--quick"] if quick else [])]
    done = subprocess.run(call, stdout=subprocess.PIPE, text=True, check=False)
    return float(done.stdout.split()[-1]) if done.returncode == 0 else None


def first_call(task: Task) -> float:
    """Seconds of the first call of the first way."""
    begin = time.perf_counter()
    make = next(iter(task.ways.values()))
    make(task.tolerances[0])()
    return time.perf_counter() - begin


def result(name: str, task: Task, quick: bool, tell: Callable[[str], None]) -> dict[str, Any]:
    """All that is found about a task, as JSON knows it."""
    from hybrid.benchmark.precision import machine
    from hybrid.trajectory.stats import versions

    begin = time.perf_counter()
    rows = measured(task, tell)
    return {
        "task": name,
        "title": task.title,
        "text": task.text,
        "unit": task.unit,
        "wanted": task.wanted,
        "rows": [attrs.asdict(row) for row in rows],
        "floor": floor_of(task, rows),
        "second process": again(name, quick),
        "versions": versions(),
        "machine": machine(),
        "seconds": time.perf_counter() - begin,
    }


def tell(line: str) -> None:
    """Say how far it is."""
    print(f"  {line}", file=sys.stderr, flush=True)


def main() -> None:
    from tasks import TASKS, task_of

    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=", ".join(TASKS))
    parser.add_argument("--quick", action="store_true", help="small, to see that all works")
    parser.add_argument("--json", type=Path, help="a folder for the numbers")
    parser.add_argument("--first", action="store_true", help="only the first call of the first way")
    given = parser.parse_args()
    for name in given.tasks or TASKS:
        task = task_of(name, given.quick)
        if given.first:
            print(first_call(task))
            continue
        found = result(name, task, given.quick, tell)
        rows = [Row(**row) for row in found["rows"]]
        print(f"\n## {task.title}\n\n{task.text}\n\n{table(rows, task)}\n")
        if found["floor"]:
            print(floor_text(found["floor"]))
        if given.json:
            given.json.mkdir(parents=True, exist_ok=True)
            (given.json / f"{name}.json").write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
