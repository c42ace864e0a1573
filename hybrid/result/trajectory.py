"""What a run returns: its data, and the methods to use them."""

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

    ``run(t)`` is the state at a time, ``run.arcs`` and ``run.jumps`` are the tables, ``run.final``
    and ``run.mode`` the state and mode at the end.

    Attributes
    ----------
    parameters : dict
        Values of the model's parameters.
    log : Log
        The stored data, for internal use: arcs, summed series of impacts, and jumps.
    zeno : list of Accumulation
        Limit points of jumps, in order.
    samples : array, shape (number of times, n), or None
        With ``save=times``: the states at these times.
    grazings : list of Jump
        Tangencies of a guard, which fire no edge (``before`` and ``after`` are equal).
    status : Status
        How the run ended; ``str(run.status)`` is a sentence with the remedy.
    options : dict
        The options of :func:`hybrid.simulate` by name, with the method, tolerances and mode that
        were used. If states at given times were asked for, ``save`` is ``"times"`` and ``times``
        holds them. The history of a model with delays is not included.
    pairs : list of (int, int)
        Places of the positions and velocities of contacts in the state vector.
    hindsight : Hindsight or None
        Evaluates the model at past times of the run, for internal use; None in a run that was
        loaded.
    stats : Stats or None
        Numbers of steps and evaluations, and the duration; None in an old file.
    versions : dict
        Versions of this package, Python and the libraries; empty in an old file.
    """

    def __add__(self, more: Trajectory) -> Trajectory:
        """This run joined with one that continues it.

        Times, arcs, jumps, accumulations, grazings, saved states and stats are joined, and ``j``
        continues to count. The arc that was cut becomes one arc again; if the next run begins in
        another mode (a rest that begins at that time), two arcs meet without a jump. ``options``
        are those of ``more``, with the larger tolerances of the two.

        Raises
        ------
        OptionError
            If ``more`` has another model or other parameters, or does not begin at the time, in the
            mode and in the state in which this run ended.
        """
        return join(self, more) if isinstance(more, Trajectory) else NotImplemented

    def settles(self) -> Settled:
        """Whether the run has come to rest or to a periodic orbit, as far as it shows.

        Returns
        -------
        Settled
            ``.kind`` is ``"rest"``, ``"periodic"`` or ``"none"``, and ``.reason`` a sentence with
            the evidence. ``.period``, ``.jumps`` (per period), ``.distance`` and ``.rate`` give
            numbers; ``.for_ever`` is true for a rest that nothing can end.

        Raises
        ------
        OptionError
            If dense output is needed but was not kept.

        Notes
        -----
        An orbit is accepted if its turns have been closer than 10 ``rtol`` for a quarter of the
        run, or have come that close at an even rate, or are approaching at an even rate that leaves
        less than a thousandth of its size to go. Changes below 100 ``atol`` count as none. (With
        Taylor series at default tolerances, 1e-8 and 1e-10 are used, as for other solvers.) A rest
        is permanent if flow, guards and held gaps do not depend on time, the state does not change
        at all, and delays have seen nothing else for the longest lag; if it may end, the reason
        says so.
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
        """Draw the run: states over time, modes, phase portrait, times between jumps.

        Parameters
        ----------
        names : sequence of str, optional
            States and outputs to draw; all states if omitted. ``run.plot("run.png")`` gives the
            path instead.
        path : str or path, optional
            Also write the figure there. A name that ends in ``.html`` gives an interactive page
            that needs no network (extra ``report``).
        panels : sequence of str, optional
            Some of ``"time"``, ``"phase"`` (of the first two names), ``"gaps"`` and ``"modes"``.
            All of them if omitted, but only ``"time"`` if names are given. Empty panels are left
            out.
        ax : matplotlib.axes.Axes, or several, optional
            Draw on these axes, one for each panel; the rest of their figure is not touched.
        size : (width, height), optional
            Size of the figure in inches.

        Returns
        -------
        matplotlib.figure.Figure
            For ``.html`` a ``plotly`` figure.

        Raises
        ------
        OptionError
            If matplotlib (for a page, plotly) is missing; if a name, panel, size or path cannot be
            used; if the number of axes is not that of the panels.
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
        """Write an animation of a model that has a :func:`hybrid.picture`.

        Parameters
        ----------
        path : str or path
            Ends in ``.gif``.
        seconds : float
            Duration of the animation, independent of the times of the run.
        fps : int
            Frames per second.
        size : (width, height)
            In inches, with 100 dots per inch.

        Raises
        ------
        OptionError
            If matplotlib is missing, the path cannot be used, the model has no
            :func:`hybrid.picture`, or the run keeps no dense output.
        """
        need("run.animate", PLOT)
        from ..plot.moving import animate

        animate(self, path, seconds, fps, size)

    def _repr_html_(self) -> str:
        """The notebook representation: the text of ``repr`` and a small picture."""
        return f"<pre>{escape(repr(self))}</pre>\n{sketch(self)}"

    def to_xarray(self, t: Any = None) -> xarray.Dataset:
        """The states and outputs over time as a dataset.

        Parameters
        ----------
        t : array, optional
            Times. If omitted, the times that the run was asked to save, or both ends of each arc
            and 15 times in between.

        Returns
        -------
        xarray.Dataset
            Variables over the dimension ``time``, with units; parameters as attributes.

        Raises
        ------
        OptionError
            If xarray is missing, or a time is outside the run.
        """
        return files.to_xarray(self, t)

    def save(self, path: Any) -> None:
        """Write the whole trajectory, with its dense output, to a NetCDF file (``run.nc``).

        :func:`hybrid.load` reads it. An existing file is replaced only when the new one is
        complete.

        Raises
        ------
        OptionError
            If a package is missing, or the name is that of another format.
        StoreError
            If the file cannot be written.
        """
        files.save(self, path)


def load(path: Any, model: Any = None) -> Trajectory:
    """Read a trajectory written by ``run.save(path)``.

    Parameters
    ----------
    path : str or path
    model : type or Automaton, optional
        The model of the run, which is needed to compute its outputs and forces: the file holds only
        the names of the outputs.

    Returns
    -------
    Trajectory

    Raises
    ------
    StoreError
        If there is no such file, it was not written by this package, or it is damaged; if ``model``
        has another name, other states or other parameters than the model of the run.

    Notes
    -----
    The file is read by HDF5, some versions of which can be crashed by a malicious file: load files
    that you do not trust in a separate process.
    """
    return files.read(path, Trajectory, model)
