"""Names of the columns and codes in the arrays that the rules share (:mod:`.advance`)."""

#: Columns of the table of fields.
FIELD_PROGRAM = 0  # the program of the flow and its guards
GUARDS = 1  # where the guards of the field begin
GUARDS_END = 2  # where they end; the clocks follow
PLAIN = 3  # 1 if the loop may fly its arcs; 0 if not; or CHANGES
CONSTRAINED = 4  # 1 if contacts are held in it, or the state slides
WATCH = 5  # a program of the guards alone, for the steps of outside solvers
SURFACE = 6  # while sliding, the program that moves a state onto the surface; otherwise -1
JOINS = 7  # 1 if the loop may add contacts to those held, and keep them after jumps
BASE = 8  # the field of its mode in which no contact is held
ONTO_GAPS = 9  # with contacts held, the program that moves a state onto their gaps; otherwise -1
ONTO_SPEEDS = 10  # the same for their gap speeds
LAGS = 11  # the program of the lags if any of them moves; otherwise -1
CLOCKS_END = 12  # where its clocks end

#: PLAIN: with an outside solver, steps must end where the flow changes its formula.
CHANGES = 2

#: Columns of the table of guards.
KIND = 0  # EDGE, CONTACT, ...
CROSSING = 1  # the direction in which it fires: -1 falling, 1 rising, 0 either
BOUNDS = 2  # 1 if it bounds the domain of the mode
AFFINE = 3  # 1 if it is an affine function of the states
TO = 4  # the field after its jump; UNKNOWN, or NONE
RESET = 5  # the program of its reset or impact; -1 if there is none, or Python makes the jump
LAND = 6  # the program that moves a state onto a contact; below 0 if there is none
SIZES = 7  # the program of the sums of absolute terms of the guard and two derivatives
USES = 8  # where the list of the states in it begins
USES_END = 9  # where it ends
BENDS = 10  # 1 if it may change its formula
# AT: a contact: first program of its sum; a surface, or the end of sliding: the guard on the other
# side, or in the field that follows; a clock: the program of its next time; the end of a moving
# lag's window: twice the lag, plus one at the later end
AT = 11
LOCAL = 12  # a contact: 1 if all flights of a sum see the same forces
SIGHT = 13  # a contact: the program that bounds what a sum passes over
# REST: a contact: the field in which it is held, too; a load: its contact in the base field; a
# surface: the field that slides on it
REST = 14
DEPENDS = 15  # a contact: 1 if its restitution is not constant
OWN = 16  # the same guard in the base field; a load is its own
CONDITION = 17  # the program of an edge's condition; NONE if it has none
URGENT = 18  # 1 if an edge fires where its guard is beyond zero on entering
GUARD_COLUMNS = 19

#: Entries of these tables that have not been asked for yet; that do not exist; that only Python
#: handles.
UNKNOWN, NONE, HARD = -1, -2, -3

#: The start of an arc has changed: a contact is held now; or the field for that is missing.
JOINED, WANTED = -4, -5

#: LAST_USED at the start of a run: no guard.
AT_START = -1

#: Kinds of guards.
EDGE = 0  # an edge
CONTACT = 1  # the gap of a contact
RELEASE = 2  # the load of a contact at rest
WINDOW_END = 3  # the end of a moving lag's window
SWITCH = 4  # the surface of a switching
LEAVE = 5  # the end of sliding
CLOCK = 6  # a clock; it has a time, and no guard function

#: The power of the time by which a gap opens where its load has become zero; and where the load
#: pulls, or an impact has left no speed.
RISES, PULLED = 3, 2

#: Numbers of a run.
LAST_TIME = 0  # the end of the run, of the windows of the past or of the piece of a signal
ABSOLUTE = 1  # the absolute tolerance that is least
RELATIVE = 2  # the relative tolerance
SPEED_FALL = 3  # a sum is tried again once the speed has fallen by this factor
FIRST_SUMMED = 4  # the least number of impacts in a series that is summed
FIRST_STEP = 5  # the longest first step of an arc
MAX_STEP = 6  # the longest step
REST_AFTER = 7  # what follows an accumulation: DRIVERS, GOES_ON_AT_REST, ENDS_THERE
CLOSING = 8  # the tolerance of a sum, relative to that of the run
WATCHED = 9  # 1 if steps are checked against the flow all along
METHOD_ORDER = 10  # the order of the outside solver; 0 with Taylor steps
JUMPS_DUE = 11  # the number of jumps after which new windows of the past are needed
UNTIL = 12  # the latest end of the current arc
RUN_END = 13  # the end of the run
SHAKEN = 14  # 1 if states are moved by rounding behind impacts that alternate
STEP_LOSS = 15  # the error that a Taylor step may make, relative to the state
TOLERANCES = 16  # from here on, the absolute tolerance of each state

#: Numbers of the current state.
T = 0  # the time at which the arc began
LOW = 1  # its low part, in two-float arithmetic
TAU = 2  # the local time
TRIED = 3  # the gap speed at which a sum was tried last
STEP_END = 4  # the local time at which the step ends
TO_TAU = 5  # the local time to which the solver is to step, or on which it is to land
AIM = 6  # the expected end of the arc
FIRST_LENGTH = 7  # the length of the first step
GAP_SPEED = 8  # the gap speed after an impact
DUE = 9  # the time of the clock that rings first
PULL = 10  # the force that draws a contact back in the flight from it; 0 if it is not known
SERIES_REACH = 11  # the length of the last step of the whole order that its series ended
STEPS_LOST = 12  # what another solver's steps have lost, in tolerances (:mod:`.ties`)
BEYOND_BY = 13  # how far beyond its kink a guard jumped last, with the guard's sign there
STATE_FLOATS = 14

#: Integers of the current state.
FIELD = 0  # the field
FIRED = 1  # the guard that fired
SERIES = 2  # the contact of the current series of impacts (OWN); -1 if there is none
IMPACT_COUNT = 3  # the number of its impacts
ENTERED = 4  # 1 if Python has examined the start of the arc
JUMPS_MADE = 5  # jumps left by this call
STEPS_MADE = 6  # steps left by this call
EXPANSIONS = 7  # Taylor expansions made by this call
PHASE = 8  # what comes next: BEGINS, WALKS, ...
MADE = 9  # steps made in the current arc
EVENT = 10  # the guard that fires in the step; -1 if none does
CROSSED = 11  # the kink at which the step ends; -1 if none
LANDINGS_TRIED = 12  # iterations of the landing
TAILS = 13  # sums left by this call
GUARD_POWER = 14  # the power of the time by which the guard last used vanishes
LOW_AHEAD = 15  # 1 if a low flight begins; 2 if its series has been checked
WAS_LOW = 16  # 1 if a low flight has just ended
FLIGHTS = 17  # arcs of positive length so far, and one more
LAST_USED = 18  # the guard last used (OWN)
LACKING = 19  # the guard whose entry in the table is missing
LACKING_AT = 20  # the column of that entry
LASTED = 21  # 1 if the arc before had a positive length
RINGS = 22  # the clock that rings first
FLOWING = 23  # the number of states that flow; discrete variables follow
SHORT = 24  # 1 if the step is made by series of lower order
PROVED = 25  # 1 if Python has shown that the sum at hand passes over no event
CUT = 26  # the sign beyond the kink at which a guard jumps, which ends the arc; 0 if none does
STATE_INTS = 27

#: Columns of the zeros of guards in a step.
WHEN = 0  # when the guard fires
BLUR = 1  # how much the remainder of its series may move that
OFF = 2  # how far from zero it was at the start of the arc, where it vanishes
MADE_OF = 3  # the sum of its absolute terms there; negative if it is not known
REACHES = 4  # 1 if it fires at a kink
VALUE, RATE, HALF_BEND = 5, 6, 7  # of the guard, where the last step ended
SERIES_END = 8  # how far of a step its series is to be read
ZERO_COLUMNS = 9

#: What comes next in an arc.
BEGINS = 0  # its start
WALKS = 1  # a step
LOOKS = 2  # to search the step for events; an outside solver's by the series of the flow
LANDS = 3  # to land on the event
STRIKES = 4  # the jump
SEES = 5  # to search an outside solver's step by its polynomial
HELD = 6  # to use a step that has been checked

#: Columns of the table of sums.
JUMPS_BEFORE = 0  # the number of jumps before it
CURVE_DEGREE = 1  # the degree of its curve
LAST_SPEED = 2  # the gap speed after the last impact before it
RATIO = 3  # the ratio of successive speeds
REMAINING = 4  # the time from that impact to the limit

#: Rows of the curve of a sum; its coefficients come first.
ERRORS = 17  # bounds on the errors of the limit
AT_LIMIT = 18  # the state at the limit
AT_REST = 19  # the state from which the run goes on at rest
CURVE_ROWS = 20

#: Why a call of the loop comes back.
END = 1  # the end of the run is reached
FULL = 2  # the arrays are full
LOOK = 3  # the arc needs all the rules, in Python
JUMP = 4  # the jump needs all the rules
STEP = 5  # an outside solver is to make a step
LAND_ON = 6  # it is to end its step at TO_TAU
SUM = 7  # impacts are to be summed (answered within the loop)
MAKE = 8  # an entry of a table is missing
HOPS = 9  # a low flight begins (answered within the loop)
SHOW = 10  # the polynomial of its step is needed
WINDOW = 11  # new windows of the past are needed
NO_ROOM = 12  # the record of the past is full
HOLD = 13  # a step, or a low flight, is to be checked against the flow
PROOF = 14  # whether the sum at hand passes over no event is to be shown in ball arithmetic

#: REST_AFTER: what a run does at an accumulation.
DRIVERS = 0.0  # Python handles it
GOES_ON_AT_REST = 1.0  # it goes on at rest
ENDS_THERE = 2.0  # it ends

#: Numbers of the record of the past.
FINAL = 0  # the end of the run
RTOL = 1  # the relative tolerance
SERVES_UNTIL = 2  # the time until which the windows are valid
SINCE = 3  # the time at which the arc began whose steps are recorded next
SINCE_LOW = 4  # its low part
BEGAN = 5  # the local time at which the arc entered the current windows
STARTED = 6  # the start of the run
STRIDE = 7  # guesses: the length of a window; 0 if nothing is guessed
SHORTEST_LAG = 8  # guesses: the shortest lag
WRONG = 9  # guesses: the error of the last
MOST = 10  # guesses: the longest that the next window may be
GUESSED_FROM = 11  # guesses: the time at which the current window began
ROUGH_FROM = 12  # where the record was first not smooth
ASKED_FROM = 13  # values of the record are asked for from this time
ASKED_UNTIL = 14  # until this one
READ_FROM = 15  # windows were last read from this time
PAST_FLOATS = 16

#: Integers of the record of the past.
PIECES_KEPT = 0  # pieces recorded
BREAKS = 1  # breaking points
STEPS_DONE = 2  # steps of the call that have been recorded
JUMPS_DONE = 3  # the same for jumps
SUMS_DONE = 4  # the same for sums
FLIGHTS_DONE = 5  # the same for flights of a sum
STEPPED = 6  # steps since the windows were read
TIGHT = 7  # successive windows that were one step long
BREAK_ORDER = 8  # breaking points up to this order are noted
IN_ARC = 9  # the arc that has gone on through windows
AGAIN = 10  # a status to be returned once there is room
GUESSED = 11  # 1 if the windows are a guess
GUESSES = 12  # guesses made at them so far
REST_OF_GUESSES = 13  # windows to come without a guess, as the last was not worth it
PIECES_KNOWN = 14  # pieces that are known
STEPS_BEFORE = 15  # steps recorded before the guess
ROUGH_PLACES = 16  # places where the record was not smooth
ASKING = 17  # the lag whose values are asked for; -1 if none
ASKED = 18  # the first piece asked for
ASKED_UP_TO = 19  # the last
BEHIND = 20  # what the flow reads behind a jump: SAME, ANEW or FORGETS
READS = 21  # times that windows have been read from one time, with no jump between
PAST_INTS = 22

#: BEHIND: what the flow reads of the past behind a jump.
SAME = 0  # the same windows: all lags are constant
ANEW = 1  # the windows at the new places
FORGETS = 2  # the state after the jump: the past is erased

#: What comes of reading the windows.
FOUND = 0  # they are found
ASKS_VALUES = 1  # values of the record are asked for
RECORD_NOT_FINITE = 2  # the record is not finite
ROUGH = 3  # it is not smooth
HOLDS = 4  # the guess holds
NEXT_TO_NOTHING = 5  # a lag is too short for any guess

#: Degree of the polynomial on a window of the past.
WINDOW_DEGREE = 12

#: A guard has fired, and the state is on it. The arc goes on.
LANDED, GOES_ON = 0, -1
