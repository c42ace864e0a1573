"""Where things are in the arrays of the loop, and what its numbers mean (:mod:`.advance`)."""

#: Columns of the table of fields: its program, where its guards begin and end, whether its arcs may
#: be plain (``CHANGES``, if another solver's steps are to end where the flow changes its formula),
#: whether contacts are held in it or it slides, and a program of its guards alone, for
#: the steps of other solvers; of one that slides the program of the way back onto the surface, of
#: others -1; whether contacts join those held, and stay held after jumps, without the driver; the
#: field of its mode in which none is held; of one with contacts held programs that move a state
#: along these, by what their gaps are off zero, and their gap speeds, of others -1; the program of
#: lags of which any moves, else -1; where its clocks end, which begin behind its guards.
FIELD_PROGRAM, GUARDS, GUARDS_END, PLAIN, CONSTRAINED, WATCH, SURFACE = range(7)
JOINS, BASE, ONTO_GAPS, ONTO_SPEEDS, LAGS, CLOCKS_END = range(7, 13)

CHANGES = 2

#: Columns of the table of guards. ``TO`` is a field, -1 where it is not known yet; ``RESET``,
#: ``LAND`` and ``SIZES`` are programs, -1 where there is none; ``USES`` is where the elements of
#: the state begin that it is made of; ``BENDS`` whether it may change its formula. Of a contact
#: whose impacts were to be summed: the first of the programs of what happens there, whether all
#: flights see the same forces; and where a sum was found, the program of its bounds, and whether
#: its restitution is no constant. At ``REST`` of a contact the field in which it is held besides
#: those that are, and of a load its contact where none is held. Of the surface of a switching: at
#: ``AT`` its guard on the other side, and at ``REST`` the field that slides on it, where one is to
#: be entered; of an end of sliding at ``AT`` the surface's guard in the field that follows. Of the
#: end of a moving lag's window at ``AT`` the lag times two, and one more at the end ahead; of a
#: clock the program of the first of its times behind another. ``OWN`` is the same guard where no
#: contact is held; a load is its own. ``CONDITION`` is the program of an edge's condition, ``NONE``
#: where it has none; ``URGENT`` whether an edge fires where its guard is beyond zero on entering.
#: The last is how many columns there are.
KIND, CROSSING, BOUNDS, AFFINE, TO, RESET, LAND, SIZES, USES, USES_END, BENDS = range(11)
AT, LOCAL, SIGHT, REST, DEPENDS, OWN, CONDITION, URGENT, GUARD_COLUMNS = range(11, 20)

#: What has not been asked for yet; what there is none of; what only the driver looks at.
UNKNOWN, NONE, HARD = -1, -2, -3

#: The start of an arc is another: a contact has come to be held there; or that field is asked for.
JOINED, WANTED = -4, -5

#: What has led to an arc at the start of a run: no guard.
AT_START = -1

#: Kinds of guards: of edges and contacts, loads, ends of windows, the surface of a switching, and
#: the ends of sliding; clocks, which are not watched.
EDGE, CONTACT, RELEASE, WINDOW_END, SWITCH, LEAVE, CLOCK = range(7)

#: By which power of the time a gap opens where its load has come to be zero, and where that pulls;
#: a contact that an impact has left no speed closes by that, too.
RISES, PULLED = 3, 2

#: Places in the numbers of a run: last time, tolerances, series of impacts; the longest steps, the
#: first of an arc and the others; whether a run goes on from an accumulation, at rest, or ends
#: there; the tolerance of a sum against the run's; whether what is made here is held against the
#: flow along all of it; the order of another solver (0 where steps are made here); the jumps after
#: which other windows of the past are due; until when the present arc goes at most; and what a step
#: may lose: a share, and from the last place on a number for each element.
LAST_TIME, ABSOLUTE, RELATIVE, SPEED_FALL, FIRST_SUMMED, FIRST_STEP = range(6)
MAX_STEP, REST_AFTER, CLOSING, WATCHED, METHOD_ORDER, JUMPS_DUE = range(6, 12)
UNTIL, STEP_LOSS, TOLERANCES = range(12, 15)

#: Places in a state's floats: the time in two; the local time; the speed at which a sum was tried
#: last; the local time at which a step ends; where the solver is to step to, or to land; where the
#: arc is expected to end; the length of its first step; the gap speed after an impact; when
#: the first clock rings; the force that draws a contact back, as far as it is known of a flight
#: from it, else 0; how long the last step was that its series ended, those of the whole order; how
#: many there are.
T, LOW, TAU, TRIED, STEP_END, TO_TAU, AIM, FIRST_LENGTH, GAP_SPEED, DUE = range(10)
PULL, SERIES_REACH, STATE_FLOATS = range(10, 13)

#: Places in a state's integers: the field, and the guard that fired; the series of impacts; whether
#: the driver has looked at the arc's start; jumps and steps kept, and expansions made; then what
#: comes next in the arc, its steps so far, the guard that fires, the kink at which the step ends,
#: landings tried, sums kept, by which power of the time the guard last used vanishes; whether the
#: flight that begins is one so low that the gap would drown in rounding (2: and follows the flow),
#: and whether one ends; arcs flown that take time; the guard last used (``OWN``); the guard of
#: which the table has not all, and the column; whether the arc before had a length; the clock that
#: rings first; how many elements of the state flow; whether the step is made by short series; how
#: many there are.
FIELD, FIRED, SERIES, IMPACT_COUNT, ENTERED, JUMPS_MADE, STEPS_MADE, EXPANSIONS = range(8)
PHASE, MADE, EVENT, CROSSED, LANDINGS_TRIED, TAILS, GUARD_POWER, LOW_AHEAD = range(8, 16)
WAS_LOW, FLIGHTS, LAST_USED, LACKING, LACKING_AT, LASTED, RINGS, FLOWING, SHORT = range(16, 25)
STATE_INTS = 25

#: Columns of the zeros of guards in a step: when each fires; by how much what its series leaves
#: open may move that; how far it was off zero where the arc began, if it vanishes there; and the
#: sum of the terms that it was made of there, below zero where that is not known.
WHEN, BLUR, OFF, MADE_OF, ZERO_COLUMNS = range(5)

#: What comes next in an arc: its start; a step; to look at a step, another solver's by series of
#: the flow; to land; the jump at its end; to look at another solver's step by its polynomial; to go
#: on with a step that has been held against the flow.
BEGINS, WALKS, LOOKS, LANDS, STRIKES, SEES, HELD = range(7)

#: Columns of the table of sums: jumps before it, and the degree of its curve; the gap speed after
#: the last of them, the ratio of the series, and the time from there to the limit.
JUMPS_BEFORE, CURVE_DEGREE, LAST_SPEED, RATIO, REMAINING = range(5)

#: Rows of each sum's curve: its coefficients, then bounds on the errors at the limit, the state
#: there, and that from which the run goes on at rest.
ERRORS, AT_LIMIT, AT_REST, CURVE_ROWS = 17, 18, 19, 20

#: Why a call comes back: the run is at its end; the arrays are full; an arc has to be looked at
#: with all the rules; a jump has; another solver is to make a step, or to land; impacts are to be
#: summed; the table has not all that is asked of a guard; a low flight begins; the polynomial of
#: another solver's step is to be shown; other windows of the past are due; there is no room for the
#: record; a step that has been made, or a low flight, is to be held against the flow.
END, FULL, LOOK, JUMP, STEP, LAND_ON, SUM, MAKE, HOPS, SHOW, WINDOW, NO_ROOM, HOLD = range(1, 14)

#: What a run does at an accumulation (``REST_AFTER``): it is the driver's; it goes on; it ends.
DRIVERS, GOES_ON_AT_REST, ENDS_THERE = 0.0, 1.0, 2.0

#: Places in the floats of a past: the last time, the relative tolerance, until when the windows
#: serve; the start of the arc whose steps are put down next, in two floats; the local time at which
#: the present arc has gone on through windows; the first time. Of guesses: the length of windows,
#: 0 without any, the shortest lag, how wrong the last was, the most that the next may span, and
#: when the present one began. Where the record was rough first; between which times values of it
#: are asked for, or where it is wrong.
FINAL, RTOL, SERVES_UNTIL, SINCE, SINCE_LOW, BEGAN, STARTED = range(7)
STRIDE, SHORTEST_LAG, WRONG, MOST, GUESSED_FROM, ROUGH_FROM = range(7, 13)
ASKED_FROM, ASKED_UNTIL, PAST_FLOATS = range(13, 16)

#: Places in its integers: pieces and breaking points; of what a call leaves steps, jumps, sums, and
#: flights of a sum, that have been put down; steps since the windows were read, windows in a row
#: that were one step long; the highest order of breaking points that are noted; the arc that has
#: gone on through windows; a status to be given once there is room. Whether the windows show a
#: guess, guesses at them so far, how many windows without any follow one that was not worth it, the
#: pieces that are known, and the steps that were put down before it. Places at which the record was
#: rough; the lag for whose window values are asked for, -1 if none are, and of which pieces. What
#: is seen behind a jump.
PIECES_KEPT, BREAKS, STEPS_DONE, JUMPS_DONE, SUMS_DONE, FLIGHTS_DONE = range(6)
STEPPED, TIGHT, BREAK_ORDER, IN_ARC, AGAIN = range(6, 11)
GUESSED, GUESSES, REST_OF_GUESSES, PIECES_KNOWN, STEPS_BEFORE, ROUGH_PLACES = range(11, 17)
ASKING, ASKED, ASKED_UP_TO, BEHIND, PAST_INTS = range(17, 22)

#: Behind a jump all lags are constant, and look through the same windows; through the same while
#: their places are in them; at the state after the jump, as all before is forgotten.
SAME, ANEW, FORGETS = range(3)

#: What comes of reading windows: they are found; values of the record are asked for; it is not
#: finite, or rough; what was guessed holds; a lag is next to nothing, and no guess does.
FOUND, ASKS_VALUES, RECORD_NOT_FINITE, ROUGH, HOLDS, NEXT_TO_NOTHING = range(6)

#: Degree of the polynomial on a window of the past.
WINDOW_DEGREE = 12

#: A guard has fired, and the state is on it. The arc goes on.
LANDED, GOES_ON = 0, -1
