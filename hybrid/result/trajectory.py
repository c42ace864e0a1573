"""What a run returns: its data, and what is done with them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from os import PathLike
from typing import TYPE_CHECKING, Any

import attrs

from ..errors import HTML, PLOT, need
from ..plot import is_page
from ..plot.sketch import sketch
from ..trajectory.trajectory import Solution
from . import files
from .joining import join
from .settling import Settled, settles

if TYPE_CHECKING:
    import xarray


@attrs.define(eq=False, repr=False)
class Trajectory(Solution):
    """The result of a run, in hybrid time.

    ``run(t)`` is the state at a time, ``run.arcs`` and ``run.jumps`` the tables, ``run.final``
    and ``run.mode`` where it ended.

    Attributes
    ----------
    parameters : dict
        Values of the model's parameters.
    log : Log
        What was kept: ``parts``, arcs and chattering tails, and ``own_jumps``, the jumps by the
        place of the part they led from.
    zeno : list of Accumulation
        Limit points of jumps, in order.
    samples : array, shape (number of times, n), or None
        With ``save=times``: the states at these times.
    grazings : list of Jump
        Tangencies of a guard, which fire no edge (``before`` and ``after`` are the same).
    status : Status
        An enumeration whose text is a sentence.
    options : dict
        What the run was made with: the options of :func:`hybrid.simulate` by name. Where no method,
        tolerances or mode were given, those that were taken. ``save`` is ``"times"``, and ``times``
        has them, where the states at some times were asked for. What was before the start of a
        model with delays is not among them.
    pairs : list of (int, int)
        Places of a contact's positions and velocities in the state vector.
    hindsight : Hindsight or None
        How the model looked at each time of the run (:mod:`hybrid.delay.hindsight`); None in a run
        that was loaded.
    stats : Stats or None
        Steps, and what they took; None in a run from a file that does not say.
    versions : dict
        Of this package, Python, and what computes; empty in a run from a file that does not say.
    """

    def __add__(self, more: Trajectory) -> Trajectory:
        """This run and one that goes on where it ended, as one.

        Times, arcs, jumps, accumulations, grazings, saved states and stats are joined, ``j`` counts
        on. The arc that was cut is one arc again; where the next begins in another mode (a rest
        that begins at that time) two arcs meet without a jump. ``options`` are those of ``more``,
        tolerances the larger of the two.

        Raises
        ------
        OptionError
            If ``more`` is another model's, has other parameters, or does not begin at the time, in
            the mode and in the state in which this run ended.
        """
        return join(self, more) if isinstance(more, Trajectory) else NotImplemented

    def settles(self) -> Settled:
        """Whether the run has come to rest, or to a periodic orbit, as far as it shows.

        Returns
        -------
        Settled
            ``.kind`` is ``"rest"``, ``"periodic"`` or ``"none"``, ``.reason`` a sentence with the
            evidence, ``.period``, ``.jumps`` (a period), ``.distance`` and ``.rate`` its numbers;
            ``.for_ever`` is true of a rest that nothing can end.

        Raises
        ------
        OptionError
            If no dense output was kept where it is needed.

        Notes
        -----
        An orbit is taken for one if its turns have been closer than 10 ``rtol`` for a quarter of
        the run, or have come so close, or are coming closer, at an even rate that leaves less
        than a thousandth of its size to go. Moves of less than 100 ``atol`` count as none. (With
        Taylor series and no tolerances given, 1e-8 and 1e-10 are meant, as on other solvers.) A
        rest is for ever where neither flow nor guards, nor the gaps that are held, depend on
        time, the state does not change at all, and delays have seen nothing else for the
        longest lag; where it may end, the reason says so.
        """
        return settles(self)

    def plot(
        self,
        names: Any = None,
        path: Any = None,
        *,
        panels: Sequence[str] | None = None,
        ax: Any = None,
        size: tuple[float, float] | None = None,
    ) -> Any:
        """Draw the run: states over time, modes, phase portrait, gaps between impacts.

        Parameters
        ----------
        names : sequence of str, optional
            States and outputs to draw; all states, if omitted. A path in this place is ``path``.
        path : str or path, optional
            Also write the figure there. ``.html``: a page that zooms and answers the pointer,
            and needs no network (extra ``report``).
        panels : sequence of str, optional
            Some of ``"time"``, ``"phase"`` (of the first two names), ``"gaps"`` and ``"modes"``;
            all of them if omitted, ``"time"`` where names are given. What would be empty is left
            out.
        ax : matplotlib.axes.Axes, or several, optional
            Draw there, a panel on each; nothing else of their figure is touched.
        size : (width, height), optional
            In inches.

        Returns
        -------
        matplotlib.figure.Figure
            With ``.html`` plotly's ``Figure``.

        Raises
        ------
        OptionError
            If matplotlib, or for a page plotly, is missing; if a name is that of no state or
            output, or a panel is none of these; if there are more or fewer axes than panels.
        """
        if isinstance(names, str | PathLike):
            names, path = None, names
        from ..plot.of_run import figure

        if is_page(path):
            need("run.plot to .html", HTML)
            from ..plot.interactive import draw as draw_page

            return draw_page(figure(self, names, panels), path)
        need("run.plot", PLOT)
        from ..plot.static import draw, draw_on

        if ax is not None:
            return draw_on(figure(self, names, panels), ax)
        return draw(figure(self, names, panels), path, size)

    def animate(
        self,
        path: Any,
        *,
        seconds: float = 6.0,
        fps: int = 20,
        size: tuple[float, float] = (4.0, 4.0),
    ) -> None:
        """Write a moving picture of a model that says what it looks like (:func:`hybrid.picture`).

        Parameters
        ----------
        path : str or path
            Ends in ``.gif``.
        seconds : float
            How long it lasts, whatever the times of the run are.
        fps : int
            Frames in a second.
        size : (width, height)
            In inches, of a hundred dots.

        Raises
        ------
        OptionError
            If matplotlib is missing; if the model does not say what it looks like, or the run keeps
            no dense output.
        """
        need("run.animate", PLOT)
        from ..plot.moving import animate

        animate(self, path, seconds, fps, size)

    def _repr_html_(self) -> str:
        """What a notebook shows: the words of ``repr``, and a small picture."""
        return f"<pre>{escape(repr(self))}</pre>\n{sketch(self)}"

    def to_xarray(self, t: Any = None) -> xarray.Dataset:
        """The states as a dataset.

        Parameters
        ----------
        t : array, optional
            Times; where omitted, those the run was asked to save, or 16 points an arc.
        """
        return files.to_xarray(self, t)

    def save(self, path: Any) -> None:
        """Write the whole trajectory, dense output included, to a NetCDF file."""
        files.save(self, path)


def load(path: Any, model: Any = None) -> Trajectory:
    """Read a trajectory written by ``run.save(path)``.

    Parameters
    ----------
    model : type or Automaton, optional
        The model of the run, whose methods work out its outputs: a file holds their names.

    Raises
    ------
    StoreError
        If there is no such file, it was not written by this package, or it is damaged; if ``model``
        has another name, other states or other parameters than the run.

    Notes
    -----
    The file is read by HDF5, some versions of which crash on a file that was made to do so: load
    files of strangers in a process that may end.
    """
    return files.read(path, Trajectory, model)
