"""Where things are in the arrays of the loop, and what its numbers mean (:mod:`.advance`)."""

#: Columns of the table of fields: its program, where its guards begin and end, whether its arcs may
#: be plain, whether contacts are held in it, and a program of its guards alone, for the steps of
#: other solvers.
PROGRAM, GUARDS, GUARDS_END, PLAIN, HELD, WATCH = 0, 1, 2, 3, 4, 5

#: Columns of the table of guards. ``TO`` is a field, -1 where it is not known yet; ``RESET``,
#: ``LAND`` and ``SIZES`` are programs, -1 where there is none; ``USES`` is where the elements of
#: the state begin that it is made of.
KIND, CROSSING, BOUNDS, AFFINE, TO, RESET, LAND, SIZES, USES, USES_END = range(10)

#: Kinds of guards whose jumps are made here.
EDGE, CONTACT = 0, 1

#: Places in the numbers of a run: last time, tolerances, series of impacts; the longest steps, the
#: first of an arc and the others; the order of another solver (0 where steps are made here), and
#: what a step may lose: a share, and from the last place on a number for each element.
LAST, ABSOLUTE, RELATIVE, SHARE, PATIENT, FIRST_STEP, MAX_STEP, ORDER, LOSS, TOLERANCES = range(10)

#: Places in a state's floats: the time in two; the local time; the speed at which a sum was tried
#: last; the local time at which a step ends; where the solver is to step to, or to land; where the
#: arc is expected to end; the length of its first step.
T, LOW, TAU, TRIED, NEXT, TO_TAU, AIM, FIRST = range(8)

#: Places in a state's integers: the field and the guard last used; the series of impacts; whether
#: the driver has looked at the arc's start; jumps and steps kept, and expansions made; then what
#: comes next in the arc, its steps so far, the guard that fires, the kink at which the step ends,
#: and landings tried.
FIELD, FIRED, SERIES, COUNT, ENTERED, JUMPS, STEPS, EXPANSIONS = range(8)
PHASE, MADE, EVENT, CROSSED, TRIES = range(8, 13)

#: What comes next in an arc: its start; a step; to look at a step; to land.
BEGINS, WALKS, LOOKS, LANDS = 0, 1, 2, 3

#: Why a call comes back: the run is at its end; the arrays are full; an arc has to be looked at
#: with all the rules; a jump has; another solver is to make a step, or to land.
END, FULL, LOOK, JUMP, STEP, LAND_ON = 1, 2, 3, 4, 5, 6

#: A guard has fired, and the state is on it. The arc goes on.
LANDED, GOES_ON = 0, -1
