"""Names for what rules take, in annotations: from these their machine code gets its types."""

from __future__ import annotations

from typing import Any, NamedTuple

#: Contiguous arrays of ``float64``, with one axis or two.
Floats = Any
Matrix = Any

#: Contiguous arrays of ``int64``, with one axis or two.
Ints = Any
Table = Any


class Programs(NamedTuple):
    """A model as data: programs one behind the other, which :mod:`.jets` reads.

    Attributes
    ----------
    index : Table
        For each program a row: where its part of the arrays below begins and where it ends, of
        ``ops``, ``kinks``, ``output`` and ``flow``.
    ops, more : Table, Ints
        Operations, and lists of arguments that they point to.
    numbers : Floats
        What does not move.
    kinks : Table
        What is watched: its row; 1 where another formula holds beyond a zero of it, else 0; its
        kind; the row of the function that it was made of, and that of a part of this
        (:mod:`.kinks`).
    bands : Matrix
        Between which values of its argument what is watched is more than rounding.
    output : Ints
        Rows that are asked for, besides the states.
    flow : Ints
        The derivative of each state; none in a program that is for values only.
    affine : Ints
        For each output 1 if it is affine in time and state, else 0.
    timed : Ints
        For each program 1 if its flow depends on the time itself, else 0.
    code : Ints
        For each program the address of its own machine code (:mod:`hybrid.lowering.native`), or 0.
    """

    index: Table
    ops: Table
    more: Ints
    numbers: Floats
    kinks: Table
    bands: Matrix
    output: Ints
    flow: Ints
    affine: Ints
    timed: Ints
    code: Ints


class Bounds(NamedTuple):
    """Programs for bounds over a box, one behind the other, which :mod:`.bounds` reads.

    Attributes
    ----------
    index : Table
        For each a row: where its operations begin and where they end, where its results do, and
        how many these are.
    ops : Table
        Operations, and their arguments: results of those before, counted from the first.
    numbers : Floats
        Constants and parameters.
    results : Ints
    """

    index: Table
    ops: Table
    numbers: Floats
    results: Ints


class AutomatonArrays(NamedTuple):
    """An automaton as data.

    Attributes
    ----------
    programs : Programs
    fields, guards : Table
        Columns as in :mod:`.places`.
    uses : Ints
        Elements of the state of which guards are made.
    bounds : Bounds
        Of gaps' accelerations and restitutions.
    """

    programs: Programs
    fields: Table
    guards: Table
    uses: Ints
    bounds: Bounds


class Now(NamedTuple):
    """A state of a run; places in the first two as in :mod:`.places`.

    Attributes
    ----------
    floats, ints : Floats, Ints
    x, end, seen : Floats
        The state where the present arc begins, that at its end, and the sizes of all so far.
    orders : Ints
        By which power of the time each guard vanishes where the arc begins.
    signs : Ints
        The sign that each guard has where the last step ended; of one that fires that before.
    zeros : Matrix
        For each guard of the present field its zero in a step; columns as in :mod:`.places`.
    tied, spent, touched : Ints
        For each guard of the automaton, at its ``OWN``, a flight, counted from one: with the sign
        that it had before its zero that at whose end it was zero beside the one that fired, and
        fires; that after which it has fired; and, with its sign before, that at whose end rounding
        did not tell it from zero.
    impacts : Ints
        Of each contact, at its ``OWN``, the impacts since it was at rest, or another jump has
        changed its gap or gap speed.
    """

    floats: Floats
    ints: Ints
    x: Floats
    end: Floats
    seen: Floats
    orders: Ints
    signs: Ints
    zeros: Matrix
    tied: Ints
    spent: Ints
    touched: Ints
    impacts: Ints

    @property
    def noted(self) -> tuple[Ints, Ints, Ints, Ints]:
        """What is noted of guards from one flight to the next."""
        return self.tied, self.spent, self.touched, self.impacts


class Room(NamedTuple):
    """Arrays to work in.

    Attributes
    ----------
    c, aside : Matrix
        Series of a step, and a few coefficients beside it: as many rows as a program has.
    work : Floats
        For the equations of contact forces.
    rows, found : Matrix
        As :mod:`.zeros` takes them.
    sides, still : Ints
        The sides of kinks, and zeros.
    there : Floats
        A state.
    """

    c: Matrix
    aside: Matrix
    work: Floats
    rows: Matrix
    found: Matrix
    sides: Ints
    still: Ints
    there: Floats


class Left(NamedTuple):
    """What a call leaves: jumps, and the steps of the arcs before them.

    Attributes
    ----------
    when : Matrix
        For each jump its time in two floats, and the length of the arc before it.
    fired : Ints
        The guard.
    before, after : Matrix
        The states.
    owner : Ints
        For each step the arc, counted from the first.
    spans : Matrix
        Local start, and length.
    series : Matrix
        Coefficients by powers of the time, of another solver's steps by those of the share of the
        step; a row for each element of the state, no rows where nobody asks for them.
    sums, curves : Matrix
        Sums of impacts; columns of the one, and rows of the other, as in :mod:`.places`.
    """

    when: Matrix
    fired: Ints
    before: Matrix
    after: Matrix
    owner: Ints
    spans: Matrix
    series: Matrix
    sums: Matrix
    curves: Matrix


class Sums(NamedTuple):
    """What :mod:`.sums` writes into, for ``n`` states; nothing need be in it.

    Attributes
    ----------
    lines : Matrix
        Rows of numbers of the time, of the states, and of the gap speed: ``n + 2`` columns.
    small : Matrix
        Rows of as many numbers as the curve has points.
    times : Floats
        The gap's acceleration, and where the curve is, at some times.
    ints : Ints
        How many flights are known, and the branch of the first.
    high, low : Matrix
        As ``c``, for series of a higher order, and of a lower one.
    short : Room
        That of the loop, with fewer coefficients: for steps of short flights.
    starts, lengths, series, branch, end, c, aside, work, rows, found, sides
        Of flights, see :func:`.flights.fly`.
    """

    lines: Matrix
    small: Matrix
    times: Floats
    ints: Ints
    high: Matrix
    low: Matrix
    short: Room
    starts: Floats
    lengths: Floats
    series: Matrix
    branch: Ints
    end: Floats
    c: Matrix
    aside: Matrix
    work: Floats
    rows: Matrix
    found: Matrix
    sides: Ints


class Look(NamedTuple):
    """What :mod:`.sights` writes into, for ``n`` states; nothing need be in it.

    Attributes
    ----------
    stretches : Matrix
        Stretches of a tail: the first impact and the last, which part of each flight, and how often
        each may yet be halved.
    shown : Matrix
        As :func:`.sums.shown` gives it.
    box, found : Matrix
        Bounds of time, gap speed and states, and of what is made of them.
    bounded, sampled : Matrix
        What is bounded in a box, and the least and the most of it at points there.
    points, values : Matrix
        Points as columns, with the rows of a box, and what is made of them.
    laws : Matrix
        Of flights by where on the curve they begin: logarithms of the growth of the speed and of
        the restitution, and behind them the coefficients of polynomials.
    """

    stretches: Matrix
    shown: Matrix
    box: Matrix
    found: Matrix
    bounded: Matrix
    sampled: Matrix
    points: Matrix
    values: Matrix
    laws: Matrix


class Pair(NamedTuple):
    """An explicit Runge-Kutta pair, and where its steps along an arc are (:mod:`.pairs`).

    Attributes
    ----------
    matrix : Matrix
        A row for each stage, of weights of the stages before it. Behind those of the step stands
        that at its end, and then those that only dense output asks for.
    fractions : Floats
        Where in the step they are.
    errors : Matrix
        One or two rows of weights of stages up to that at the step's end.
    dense : Matrix
        Weights of all stages, a column for each power of the fraction of the step from the first
        on.
    control, going : Floats
        How the lengths of steps follow from errors; what is remembered along an arc.
    states, rates : Matrix
        States to work in, and the flow at each stage.
    """

    matrix: Matrix
    fractions: Floats
    errors: Matrix
    dense: Matrix
    control: Floats
    going: Floats
    states: Matrix
    rates: Matrix


class Slopes(NamedTuple):
    """Derivatives of an automaton's functions, by time, state and parameters.

    Attributes
    ----------
    programs : Programs
        Of functions along a flow, and of values.
    places : Table
        For each function along a flow its place in the matrix of the first variation.
    fields, guards : Table
        Which programs are whose; columns as in :mod:`.variation`.
    of_fields, of_guards : Ints
        The rows of the automaton's fields and guards; below zero as in :mod:`.places`.
    """

    programs: Programs
    places: Table
    fields: Table
    guards: Table
    of_fields: Ints
    of_guards: Ints


class Changes(NamedTuple):
    """What the first variation writes into; nothing need be in it.

    ``n`` states; ``C`` columns: time, states, parameters; ``K`` with directions for parameters.

    Attributes
    ----------
    c, work, sides
        As :func:`.jets.jets` takes them for the programs of derivatives.
    read : Floats
        What a program gives.
    orders, terms, aside, piece, flight : Matrix
        Series of a matrix along the flow, a column and a row for each of its numbers; two such
        matrices, one
        below the other; that of a piece, and that of a flight, with a gap behind the states.
    before, after : Matrix
        Changes of time, of states, and of a gap: ``C`` columns.
    lines : Matrix
        Rows of numbers.
    maps, rest, now, last, best : Matrix
        Of a limit: the maps from impact to impact at some points, and what they give; ``K``
        columns.
    lower, small : Matrix
        From values at points to those at others; what that is made of.
    equations, right, shares : Matrix
    known : Ints
        The points at which the map is known.
    arc : Matrix
        The matrix of an arc.
    state, moved : Matrix
        The change of time and state by each number that a run is asked for with, and room for it.
    out : Matrix
        What a limit gives.
    """

    c: Matrix
    work: Floats
    sides: Ints
    read: Floats
    orders: Matrix
    terms: Matrix
    aside: Matrix
    piece: Matrix
    flight: Matrix
    before: Matrix
    after: Matrix
    lines: Matrix
    maps: Matrix
    rest: Matrix
    now: Matrix
    last: Matrix
    best: Matrix
    lower: Matrix
    small: Matrix
    equations: Matrix
    right: Matrix
    shares: Matrix
    known: Ints
    arc: Matrix
    state: Matrix
    moved: Matrix
    out: Matrix


class PastArrays(NamedTuple):
    """What flows look back on, of ``n`` states and some lags (:mod:`.past`).

    Attributes
    ----------
    floats, ints : Floats, Ints
        Places as in :mod:`.places`.
    lags, moves : Floats, Ints
        The lags, as they are when windows are read, and how each of them moves.
    spans : Matrix
        A row for each piece of the record, columns as in :mod:`.windows`.
    degrees : Ints
        Their degrees; below zero where a piece is no polynomial.
    rows : Matrix
        Their Chebyshev coefficients, a row for each element of the state.
    times, orders : Floats, Table
        Breaking points, and the orders of the elements there.
    windows : Matrix
        A row for each lag, columns as in :mod:`.windows`.
    seen, heard : Table, Ints
        The elements that are seen through a lag, and through any.
    uses, asks : Table
        For each element in each field the elements on which its derivative depends, and those that
        it sees through each lag.
    bent : Table
        For each guard 1 for the elements whose derivatives a jump by it changes, apart from what it
        does to the state.
    atol : Floats
    given, ranged, parts, ops, more, numbers
        Where windows are among the numbers of programs and bounds, and the operations on numbers
        that follow, program by program.
    shown, sights : Floats, Matrix
        The windows, as programs take them; and those on which each sum was made.
    nodes, series, powers, turn
        The places at which a record is read; matrices from values there to Chebyshev coefficients,
        from these to powers; and from terms of a step to Chebyshev coefficients.
    own, least, values
        To work in.
    told : Matrix
        Values of the record that have been asked for, a row for each element of the state.
    present : Floats
        The state when windows are read.
    start, signs : Floats, Table
        The state where the present arc has gone on through windows; the signs of guards there, or
        where the present windows were read, with rows for what else is noted of guards.
    floats_before, ints_before, before : Floats, Ints, Matrix
        What the loop's state was there, but for that.
    """

    floats: Floats
    ints: Ints
    lags: Floats
    moves: Ints
    spans: Matrix
    degrees: Ints
    rows: Matrix
    times: Floats
    orders: Table
    windows: Matrix
    seen: Table
    heard: Ints
    uses: Table
    asks: Table
    bent: Table
    atol: Floats
    given: Table
    ranged: Table
    parts: Table
    ops: Table
    more: Ints
    numbers: Matrix
    shown: Floats
    sights: Matrix
    nodes: Floats
    series: Matrix
    powers: Matrix
    turn: Matrix
    own: Ints
    least: Table
    values: Matrix
    told: Matrix
    present: Floats
    start: Floats
    signs: Table
    floats_before: Floats
    ints_before: Ints
    before: Matrix


class InputArrays(NamedTuple):
    """Signals on some of their pieces (:mod:`.inputs`).

    Attributes
    ----------
    knots : Floats
        Where the pieces begin, and where the last ends.
    pieces : Matrix
        Their numbers, a row for each.
    place : Ints
        The present one; 0 where the loop is to come back at each knot; of the last knot that an arc
        has gone over, which arc of the call that is, and the steps of the call up to there.
    began, start : Floats
        The local time there, and the state.
    given, ranged, parts, ops, more, numbers
        As in :class:`PastArrays`.
    """

    knots: Floats
    pieces: Matrix
    place: Ints
    began: Floats
    start: Floats
    given: Table
    ranged: Table
    parts: Table
    ops: Table
    more: Ints
    numbers: Matrix
