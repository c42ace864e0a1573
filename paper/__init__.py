"""The paper from end to end: its claims, our figures beside them, and the verdicts.

*Analysis of Impact Chattering* (Akhmet & Çağ). A folder for each of its sections has a function
``section()``, which runs the models of the gallery and returns a :class:`~.claims.Section`;
``page`` writes them all as one page of HTML that needs no network. Whatever is ours is computed
in that run; only the paper's own words and numbers are typed in.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

from hybrid.errors import HTML, PLOT, PROOFS, OptionError, need
from hybrid.trajectory.stats import versions

from .claims import Section

#: The sections of the paper, in order.
SECTIONS = ("existence", "asymptotics", "table", "beam", "continuous", "control")


def report(
    folder: Path,
    only: Sequence[str] = (),
    progress: Callable[[Section, float], None] | None = None,
) -> Path:
    """Run the paper's models, judge its claims, write the page.

    Parameters
    ----------
    folder : Path
        Where the page and its pictures go; made if it is missing.
    only : sequence of str
        Names of sections; all if empty, each once.
    progress : callable, optional
        Called with each section when it is done, and the seconds it took.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    OptionError
        If there is no such section, a package of the extra ``report`` is missing, or the
        folder cannot be made. Nothing is run then.
    """
    unknown = sorted(set(only) - set(SECTIONS))
    if unknown:
        raise OptionError(f"no section {unknown[0]!r}; there are: {', '.join(SECTIONS)}")
    need("report", (*PLOT, *HTML, *PROOFS))
    from .page import write

    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise OptionError(f"cannot write the page to {folder}: {fault.strerror}") from None
    begun, done = time.perf_counter(), []
    for name in dict.fromkeys(only or SECTIONS):
        started = time.perf_counter()
        done.append(import_module(f".{name}", __name__).section())
        if progress is not None:
            progress(done[-1], time.perf_counter() - started)
    made = f"Made in {time.perf_counter() - begun:.0f} seconds, with {_versions()}."
    return write(done, folder, made)


def _versions() -> str:
    used = {**versions(), "plotly": version("plotly")}
    return ", ".join(f"{name} {number}" for name, number in used.items())
