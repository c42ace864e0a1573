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
            The record: ``parts`` (arcs and chattering tails) and ``own_jumps`` (jumps by the index
        of the part that they end).
    zeno : list of Accumulation
        Limit points of jumps, in order.
    samples : array, shape (number of times, n), or None
        With ``save=times``: the states at these times.
    grazings : list of Jump
        Tangencies of a guard, which fire no edge (``before`` and ``after`` are equal).
    status : Status
        An enumeration whose text is a sentence.
    options : dict
            The options of :func:`hybrid.simulate` by name, with the method, tolerances and mode
        that were used if none were given. If states at given times were requested, ``save`` is
        ``"times"`` and ``times`` holds them. The history of a model with delays is not included.
    pairs : list of (int, int)
        Indices of contacts' positions and velocities in the state vector.
    hindsight : Hindsight or None
            The model as it was at each time of the run (:mod:`hybrid.delay.hindsight`); None for a
        loaded run.
    stats : Stats or None
        Steps and their cost; None if the run's file does not contain them.
    versions : dict
            Versions of this package, Python, and the numerical packages; empty if the run's file
        does not contain them.
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
                If ``more`` has another model or other parameters, or does not begin at the time, in
            the mode and in the state in which this run ended.
        """
        return join(self, more) if isinstance(more, Trajectory) else NotImplemented

    def settles(self) -> Settled:
        """Whether the run has come to rest or to a periodic orbit, as far as it shows.

        Returns
        -------
        Settled
                ``.kind`` is ``"rest"``, ``"periodic"`` or ``"none"``, and ``.reason`` a sentence
            with the evidence. ``.period``, ``.jumps`` (per period), ``.distance`` and ``.rate``
            give numbers; ``.for_ever`` is true for a rest that nothing can end.

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
        """Plot the run: states over time, modes, phase portrait, gaps between impacts.

        Parameters
        ----------
        names : sequence of str, optional
                States and outputs to plot; by default all states. A path given here is taken as
            ``path``.
        path : str or path, optional
                Also write the figure to this file. ``.html``: an interactive page that needs no
            network (extra ``report``).
        panels : sequence of str, optional
                Some of ``"time"``, ``"phase"`` (of the first two names), ``"gaps"`` and
            ``"modes"``; by default all, or ``"time"`` if names are given. Empty panels are omitted.
        ax : matplotlib.axes.Axes, or several, optional
            Axes to plot on, one per panel; the rest of their figure is not changed.
        size : (width, height), optional
            In inches.

        Returns
        -------
        matplotlib.figure.Figure
            With ``.html``, a plotly ``Figure``.

        Raises
        ------
        OptionError
                If matplotlib (for a page: plotly) is missing, a name is neither a state nor an
            output, a panel is unknown, or the numbers of axes and panels differ.
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
        """Write an animation of a model that declares its picture (:func:`hybrid.picture`).

        Parameters
        ----------
        path : str or path
            Ends in ``.gif``.
        seconds : float
            Duration of the animation, whatever the time span of the run.
        fps : int
            Frames per second.
        size : (width, height)
            In inches, at 100 dots per inch.

        Raises
        ------
        OptionError
                If matplotlib is missing, the model declares no picture, or the run keeps no dense
            output.
        """
        need("run.animate", PLOT)
        from ..plot.moving import animate

        animate(self, path, seconds, fps, size)

    def _repr_html_(self) -> str:
        """The notebook representation: the text of ``repr`` and a small picture."""
        return f"<pre>{escape(repr(self))}</pre>\n{sketch(self)}"

    def to_xarray(self, t: Any = None) -> xarray.Dataset:
        """The states as a dataset.

        Parameters
        ----------
        t : array, optional
                Times; by default those that the run was asked to save, or both ends and 15 points
            of each arc.
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
        The model of the run. It is needed to evaluate outputs, as the file holds only their names.

    Raises
    ------
    StoreError
            If there is no such file, it was not written by this package, or it is damaged; or if
        the name, states or parameters of ``model`` do not match the run.

    Notes
    -----
    The file is read by HDF5, some versions of which crash on maliciously crafted files: load
    untrusted files in a process of their own.
    """
    return files.read(path, Trajectory, model)
