"""Write docs/benchmarks.md: what the scripts beside this one print, of one machine.

    python benchmarks/report.py [NAME ...]

Each script runs alone, in a process of its own, and what it has printed is kept in
``out/benchmarks/``: begun again, only what is missing runs, or what is named. The text of the page
is that of the scripts themselves.
"""

from __future__ import annotations

import argparse
import ast
import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import hybrid

HERE = Path(__file__).parent
KEPT, PAGE = HERE.parent / "out/benchmarks", HERE.parent / "docs/benchmarks.md"

#: Scripts with their arguments, by the title of their section.
SECTIONS = {
    "One accumulation": ["example_1.py"],
    "Impacts, six tasks": ["impacts.py"],
    "Delays": ["delays.py"],
    "Many runs at once": ["ensembles.py"],
    "Derivatives": ["derivatives.py"],
    "No edge": ["no_edge.py"],
    "The first call": ["first_call.py"],
    "Growth": ["growth.py"],
}

PACKAGES = ["jax", "diffrax", "scipy", "numpy", "numba", "heyoka", "scikit-sundae", "jitcdde"]

HEAD = """# Benchmarks

Time beside error, of one machine: {machine}.
Ratios hold elsewhere, milliseconds do not. Everything on this page is made by
`python benchmarks/report.py`, of which each script may be run alone; `hybrid bench MODEL` asks the
same of a model of your own. Peers are the best that their own idioms allow.

{versions}.
"""

SECTION = """## {title}

{text}

`benchmarks/{command}`:

```text
{printed}```
"""


def machine() -> str:
    """Processor, number of its cores, system, Python."""
    told = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.split(":", 1)[1].strip() for line in told if line.startswith("model name")]
    system = f"{platform.system()}, Python {platform.python_version()}"
    return f"{(names or ['a processor'])[0]}, {os.cpu_count()} cores, {system}"


def versions() -> str:
    """Of hybrid and of what it is compared with; what is not installed is named."""
    found = [f"hybrid {hybrid.__version__}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"{package} is not installed")
    return ", ".join(found)


def printed(command: list[str], again: bool) -> str:
    """What a script has printed when it ran last."""
    kept = KEPT / f"{Path(command[0]).stem}.txt"
    if again or not kept.exists():
        print(*command, flush=True)
        call = [sys.executable, str(HERE / command[0]), *command[1:]]
        path = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])
        around = {**os.environ, "PYTHONPATH": path}
        done = subprocess.run(call, env=around, stdout=subprocess.PIPE, text=True, check=True)
        KEPT.mkdir(parents=True, exist_ok=True)
        kept.write_text(done.stdout)
    return kept.read_text()


def section(title: str, command: list[str], again: bool) -> str:
    """What a script says of itself, and what it has printed."""
    lines = (ast.get_docstring(ast.parse((HERE / command[0]).read_text())) or "").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("    ")).replace("``", "`")
    shown = {"text": text, "command": " ".join(command), "printed": printed(command, again)}
    return SECTION.format(title=title, **shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="scripts that run again")
    again = parser.parse_args().names
    parts = [section(t, c, Path(c[0]).stem in again) for t, c in SECTIONS.items()]
    head = HEAD.format(machine=machine(), versions=versions())
    PAGE.write_text("\n".join([head, *parts]))


if __name__ == "__main__":
    main()
