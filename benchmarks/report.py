"""Time beside error, all tasks: docs/benchmarks.md, its figures and numbers, the README's table.

    python benchmarks/report.py [--again NAME ...] [--page] [--quick]

Each task runs in a process of its own, and its numbers are kept in ``out/benchmarks/``: begun
again, only what is missing runs, or what is named; a task that fails or takes too long is said and
left out. ``--page`` runs nothing and writes the page of what is kept. ``--quick`` is for seeing
that all works: small tasks, kept apart, and the page beside them.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE), str(ROOT)]

from hybrid.plot.figure import Curve, Figure, Panel, column, looks_of_method  # noqa: E402
from hybrid.plot.static import draw  # noqa: E402
from measure import Row, best, floor_text, reference, shown, table  # noqa: E402
from tasks import TASKS  # noqa: E402

#: Seconds after which a task is given up.
LONGEST = 300

#: Tables beside the tasks: a script and its title.
SCRIPTS = {
    "losses.py": "No impact lost, at any tolerance",
    "growth.py": "Growth",
    "derivatives.py": "Derivatives",
}

PACKAGES = ("hybrid-automata", "jax", "diffrax", "scipy", "numpy", "numba")
PEERS = ("heyoka", "scikit-sundae", "jitcdde")

HEAD = """# Benchmarks

Time beside error, of one machine: {machine}. {versions}.

Everything on this page, and the table of the README, is made by `python benchmarks/report.py`; the
numbers are in [benchmarks.json](figures/benchmarks/benchmarks.json). Ratios hold elsewhere,
milliseconds do not. `hybrid bench MODEL` asks the same of a model of your own
([choosing a solver](choosing.md#speed-against-error-on-your-own-model)).

Of each tool a table has the fastest of several tolerances that keeps to the error asked for. Its
ratio is its time as a multiple of the fastest of this package: above 1 it is slower. Peers are
written as well as their own idioms allow (`benchmarks/peers/`); they are called in turns with the
others, and a call counts by the median of its turns. A first call is that of a process that has
imported the tools; what is compiled is in it, but not the rules of this package, which are
compiled once for an installation. A floor is what the work itself takes: so many expansions of the
flow as the run makes, each at what it takes in machine code alone, and one zero by Newton's method
for each jump. Times are of the process, on one core; where several work, of the clock.
"""

#: Lines of the README's table: a task, its name there, and the peers that are named.
README = {
    "example_1_and_on": "Example 1, to its limit and on",
    "duffing": "Duffing with a wall, 10,000 impacts",
    "thrown": "chatter, rest, release, 50 times",
    "lanes": "10,000 beads, 40 impacts each",
    "pyragas": "delayed control to t = 20",
    "stiff": "a rate of 1e6, implicit",
}
COLUMNS = {
    "`solve_ivp`": "solve_ivp",
    "CVODE": "CVODE",
    "Diffrax": "diffeqsolve",
    "heyoka": "heyoka",
    "JiTCDDE": "JiTCDDE",
    "numba by hand": "numba",
}
BEGIN, END = "<!-- benchmarks: written by benchmarks/report.py -->", "<!-- benchmarks end -->"


def machine() -> str:
    """Processor, number of its cores, system."""
    try:
        told = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        told = []
    names = [line.split(":", 1)[1].strip() for line in told if line.startswith("model name")]
    return f"{(names or [platform.machine()])[0]}, {os.cpu_count()} cores, {platform.system()}"


def versions() -> dict[str, str | None]:
    """Of what is compared; None where it is not installed."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for package in (*PACKAGES, *PEERS):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = None
    return found


def run(command: list[str], seconds: float) -> tuple[str, str]:
    """What a script prints; why there is none."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    call = [sys.executable, str(HERE / command[0]), *command[1:]]
    try:
        env = {**os.environ, "PYTHONPATH": path}
        options = {"env": env, "capture_output": True, "text": True, "check": False}
        done = subprocess.run(call, timeout=seconds, **options)
    except subprocess.TimeoutExpired:
        return "", f"took more than {seconds:.0f} s"
    if done.returncode:
        return "", (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    return done.stdout, ""


def made(kept: Path, again: list[str], quick: bool) -> None:
    """Run what is missing."""
    kept.mkdir(parents=True, exist_ok=True)
    small = ["--quick"] if quick else []
    sizes = "measure.py", "losses.py"
    jobs = {
        name: (kept / f"{name}.json", ["measure.py", name, "--json", str(kept)]) for name in TASKS
    }
    jobs |= {Path(s).stem: (kept / f"{Path(s).stem}.txt", [s]) for s in SCRIPTS}
    begun = time.perf_counter()
    for number, (name, (path, command)) in enumerate(jobs.items(), 1):
        if path.exists() and name not in again:
            continue
        begin = time.perf_counter()
        print(f"[{number}/{len(jobs)}] {name} ...", end="", flush=True)
        text, fault = run([*command, *(small if command[0] in sizes else [])], LONGEST)
        print(f" {time.perf_counter() - begin:.0f} s {fault}", flush=True)
        if path.suffix == ".txt" and not fault:
            path.write_text(text)
    print(f"in all {time.perf_counter() - begun:.0f} s")


def picture(found: dict[str, Any], path: Path) -> bool:
    """Time against error, a line a tool; whether there are two errors to draw it of."""
    curves = []
    for who in dict.fromkeys(row["who"] for row in found["rows"]):
        rows = [r for r in found["rows"] if r["who"] == who and r["seconds"] and not r["lost"]]
        rows = [r for r in rows if r["error"] is not None]
        if not rows:
            continue
        look, bar = looks_of_method(sum(bool(c.name) for c in curves))
        x = [max(r["error"], 1e-16) for r in rows]
        bars = [
            (e, v) for e, r in zip(x, rows, strict=True) for v in (r["low"], r["high"], math.nan)
        ]
        curves.append(Curve(x=x, y=[r["seconds"] for r in rows], name=who, look=look))
        curves.append(Curve(x=[e for e, _ in bars], y=[v for _, v in bars], look=bar))
    if len({r["rtol"] for r in found["rows"]}) < 2 or not curves:
        return False
    panel = Panel(curves=curves, x="error", y=f"seconds {found['unit']}", log="xy", reverse=True)
    draw(Figure(name="bench", title=found["title"], columns=column(panel)), path)
    return True


def section(found: dict[str, Any], folder: Path) -> str:
    """A task: what is asked, its table, its floor, its figure."""
    rows = [Row(**row) for row in found["rows"]]
    parts = [f"## {found['title']}", found["text"], table(rows, SimpleNamespace(**found))]
    parts[1] += f" Asked for: {found['wanted']:.0e}."
    notes = [floor_text(found["floor"])] if found["floor"] else []
    if found["second process"] is not None:
        who, first = rows[0].who, shown(found["second process"])
        notes.append(f"First call of {who} in a second process: {first}.")
    if notes:
        parts.append(" ".join(notes))
    path = folder / f"{found['task']}.png"
    if picture(found, path):
        parts.append(f"![{found['title']}: time against error](figures/benchmarks/{path.name})")
    return "\n\n".join(parts)


def readme_table(results: dict[str, Any]) -> str:
    """How many times as long as this package each peer takes, at the same error."""
    lines = [f"| | error | hybrid | {' | '.join(COLUMNS)} |", "|---" * (3 + len(COLUMNS)) + "|"]
    for name, title in README.items():
        found = results.get(name)
        ours = found and reference([Row(**row) for row in found["rows"]], found["wanted"])
        if not found or ours is None:
            continue
        rows = best([Row(**row) for row in found["rows"]], found["wanted"])
        cells = [title, f"{found['wanted']:.0e}", f"{shown(ours.seconds)} {found['unit']}"]
        cells += [cell(rows, prefix, found["wanted"], ours) for prefix in COLUMNS.values()]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def cell(rows: dict[str, Row], prefix: str, wanted: float, ours: Row) -> str:
    """The ratio of a peer; in brackets where it is not as exact."""
    own = [r for who, r in rows.items() if who.startswith(prefix) and "alone" not in who]
    timed = [r for r in own if r.seconds is not None and not r.lost]
    if not own:
        return ""
    if not timed:
        return "not installed" if "not installed" in own[0].reason else "fails"
    fit = min(timed, key=lambda r: (not r.keeps(wanted), r.seconds or 0.0))
    times = (fit.seconds or 0.0) / (ours.seconds or 1.0)
    ratio = f"{times:.0f}" if times >= 10 else f"{times:.2g}"
    return ratio if fit.keeps(wanted) else f"({ratio})"


def write_readme(results: dict[str, Any], path: Path) -> None:
    """Put the table between its marks."""
    text = path.read_text()
    if BEGIN in text:
        marked = f"{BEGIN}\n{readme_table(results)}\n{END}"
        path.write_text(re.sub(f"{BEGIN}.*?{END}", lambda _: marked, text, flags=re.S))


def page(kept: Path, docs: Path) -> None:
    """The page, its figures and its numbers, of what is kept."""
    folder = docs / "figures/benchmarks"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    results = {
        name: json.loads((kept / f"{name}.json").read_text())
        for name in TASKS
        if (kept / f"{name}.json").exists()
    }
    own = versions()
    told = ", ".join(f"{n} {v or 'is not installed'}" for n, v in own.items())
    parts = [HEAD.format(machine=machine(), versions=told).rstrip()]
    parts += [section(found, folder) for found in results.values()]
    for script, title in SCRIPTS.items():
        path = kept / f"{Path(script).stem}.txt"
        if path.exists():
            shown_text = path.read_text().strip("\n")
            parts.append(f"## {title}\n\n`benchmarks/{script}`:\n\n```text\n{shown_text}\n```")
    missing = [n for n in TASKS if n not in results]
    if missing:
        parts.append(f"Not finished on this machine: {', '.join(missing)}.")
    (docs / "benchmarks.md").write_text("\n\n".join(parts) + "\n")
    kept_numbers = {"machine": machine(), "versions": own, "tasks": results}
    (folder / "benchmarks.json").write_text(json.dumps(kept_numbers, indent=1) + "\n")
    write_readme(results, docs.parent / "README.md")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--again", nargs="*", default=[], metavar="NAME", help="run these again")
    parser.add_argument("--page", action="store_true", help="only write the page")
    parser.add_argument("--quick", action="store_true", help="small tasks, a page beside them")
    given = parser.parse_args()
    kept = ROOT / "out" / ("benchmarks-quick" if given.quick else "benchmarks")
    if not given.page:
        made(kept, given.again, given.quick)
    docs = ROOT / "docs"
    if given.quick:
        docs = kept / "docs"
        docs.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "README.md", kept)
    page(kept, docs)


if __name__ == "__main__":
    main()
