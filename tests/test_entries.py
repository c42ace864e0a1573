"""What a guard does where an arc begins: the table of rule 3, and by which power it leaves zero."""

import numpy as np
import pytest

from hybrid.rules import unit
from hybrid.rules.entries import ARMED, BEYOND, FIRES, LEAVES, OUTSIDE, RESTS, UNDECIDED
from hybrid.rules.places import CONTACT, EDGE, RELEASE, SWITCH

#: A guard that bounds its mode, is positive inside, and of which nothing else is known.
PLAIN = {
    "kind": EDGE,
    "crossing": -1,
    "bounds": True,
    "order": 1,
    "sign": 1,
    "rests": False,
    "used": False,
    "spent": False,
    "derived": False,
    "passing": False,
    "before": 0,
    "urgent": False,
}


@pytest.mark.parametrize(
    ("what", "known"),
    [
        (ARMED, {}),
        (ARMED, {"order": 0}),
        (FIRES, {"sign": -1}),
        (FIRES, {"sign": 1, "crossing": 1}),
        (OUTSIDE, {"order": 0, "sign": -1}),
        (ARMED, {"order": 0, "sign": -1, "bounds": False}),
        (UNDECIDED, {"sign": 0}),
        # a contact rests where nothing opens it
        (RESTS, {"kind": CONTACT, "rests": True, "order": 2, "sign": -1}),
        (RESTS, {"kind": CONTACT, "rests": True, "order": 3, "sign": 0}),
        (ARMED, {"kind": CONTACT, "rests": True, "order": 2}),
        (FIRES, {"kind": CONTACT, "rests": True, "sign": -1}),
        # the edge just taken, and one taken at this time
        (BEYOND, {"used": True, "sign": -1}),
        (ARMED, {"used": True, "sign": -1, "bounds": False}),
        (ARMED, {"spent": True, "sign": -1, "bounds": False}),
        (FIRES, {"spent": True, "sign": -1}),
        # no inside: only where it was crossing zero at this very time
        (ARMED, {"crossing": 0, "sign": -1}),
        (FIRES, {"crossing": 0, "sign": -1, "before": 1}),
        (ARMED, {"crossing": 0, "sign": -1, "before": -1}),
        # passed by the rounding of a tie, a load that has jumped, what delays see that has
        (FIRES, {"order": 0, "sign": -1, "before": 1}),
        (FIRES, {"kind": RELEASE, "order": 0, "sign": -1, "derived": True}),
        (FIRES, {"order": 0, "sign": -1, "passing": True, "before": 1}),
        (ARMED, {"order": 0, "sign": -1, "passing": True, "before": -1}),
        # urgent: beyond zero, and at it for good, but not in the middle of an arc
        (FIRES, {"order": 0, "sign": -1, "urgent": True}),
        (FIRES, {"order": 0, "sign": -1, "urgent": True, "used": True}),
        (ARMED, {"order": 0, "urgent": True}),
        (FIRES, {"sign": 0, "urgent": True}),
        (UNDECIDED, {"sign": 0, "urgent": True, "used": True}),
        (ARMED, {"order": 0, "sign": -1, "urgent": True, "passing": True, "before": -1}),
        # on a surface: whether the other flow leaves it as well is still to be asked
        (LEAVES, {"kind": SWITCH}),
        (FIRES, {"kind": SWITCH, "sign": -1}),
    ],
)
def test_one_rule_says_what_a_guard_does(what, known):
    """At the start of an arc."""
    assert unit("entries").does(*{**PLAIN, **known}.values()) == what


@pytest.mark.parametrize("power", [1, 2, 3, 5])
@pytest.mark.parametrize("side", [1, -1])
def test_a_guard_leaves_zero_by_its_first_power(power, side):
    """Below it there are roundings of terms of size 1; from the third on coefficients compare."""
    c = np.array([3e-16, -2e-16, 1e-16, 0.0, 0.0, 0.0, 0.0, 0.0])
    c[power] = side * 0.5
    given = c, np.zeros((0, 8)), 0, c[0], c[1], 0.0, 1.0, 1.0, 1.0, 1.0, np.inf, 0, 0
    assert unit("entries").start(*given) == (power, side)


def test_a_gap_that_clearly_moves_is_zero_by_its_own_terms_only():
    """Not by those of states as large as the run has seen: a small gap is none."""
    c = np.array([1e-12, 1.0, 0.0, 0.0, 0.0])
    own = c, np.zeros((0, 5)), 0, c[0], c[1], 0.0, 1.0, 1.0, 1.0, 1e6
    assert unit("entries").start(*own, 1.0, 0, 0) == (0, 1)  # a gap
    assert unit("entries").start(*own, np.inf, 0, 0) == (1, 1)  # another guard


@pytest.mark.parametrize(("out", "found"), [(-1, (2, 1)), (0, (1, -1)), (1, (1, -1))])
def test_a_rate_that_turns_back_within_rounding_takes_no_edge(out, found):
    """At the highest point of a throw: what is left of the speed is no crossing of a ceiling."""
    c = np.array([1e-17, -1e-9, 0.5])
    given = c, np.zeros((0, 3)), 0, c[0], c[1], 0.0, 1.0, 1e-9, 1.0, 1.0, np.inf, 0
    assert unit("entries").start(*given, out) == found
    c[1] = -1e-6  # it goes deeper than rounding
    assert unit("entries").start(*given[:4], c[1], *given[5:], out) == (1, -1)
