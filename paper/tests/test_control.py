"""Section 6 of the report: Table 1 with both memories, and what explains its amplitude."""

import numpy as np
import pytest

from paper import control
from paper.claims import Verdict, rounds_to
from paper.control import loose, pyragas


def test_the_orbit_its_multiplier_and_the_border(reference):
    """To the digits known, by the section's own functions."""
    (exact,) = [
        value for key, value in reference["pyragas"].items() if key.startswith("memory restarted")
    ]
    found = pyragas.orbit()
    assert found.period == pytest.approx(float(exact["T"]), abs=1e-12)
    assert found.extrema["x1"][1] == pytest.approx(float(exact["max_x1"]), abs=1e-11)
    assert found.multipliers[1].real == pytest.approx(float(exact["multiplier"]), abs=1e-10)
    border = pyragas.border()
    assert border.start == pytest.approx(2.3848776227496940476, abs=1e-11)
    step = 1e-4
    slope = (pyragas.returned(border.speed + step) - pyragas.returned(border.speed - step)) / 2e-4
    assert border.multiplier == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("text", ["2.5", "3"])
def test_rows_of_the_table(text):
    """At rest for ever with the memory kept; on the orbit with the memory restarted."""
    found = pyragas.row(float(text))
    assert (found.certified, found.released, found.chatters) == (True, False, None)
    assert rounds_to(found.period, "1.22")
    assert not rounds_to(found.amplitude, "2.933")


def test_from_2_1_it_chatters_with_both_memories(reference):
    """The kept one within its bound of the reference."""
    found = pyragas.row(2.1)
    (exact,) = [
        value["x0=2.1"]["stick"]
        for key, value in reference["pyragas"].items()
        if key.startswith("memory kept")
    ]
    assert abs(found.rests - float(exact)) <= found.error < 1e-11
    # 25 digits, of -x^3 - cos x' - 30 (2 - x) after the first flight
    assert found.chatters == pytest.approx(0.644758648493, abs=1e-11)
    assert found.again < 1e-10
    assert control.chatters().verdict is Verdict.REPRODUCED


def test_a_method_of_low_order_gives_the_papers_amplitude():
    """2.933 and 1.22 at tolerances of 1e-3 and 1e-6; it tends to the orbit's as they fall."""
    period, amplitude = loose.orbit(1e-3, 1e-6)
    assert rounds_to(amplitude, "2.933")
    assert rounds_to(period, "1.22")
    exact = pyragas.orbit()
    finer, finest = loose.orbit(1e-5, 1e-8), loose.orbit(1e-6, 1e-9)
    height = exact.extrema["x1"][1] - 2.0
    assert abs(finest[0] - exact.period) < 0.5 * abs(finer[0] - exact.period) < 2e-5
    assert abs(finest[1] - height) < 0.5 * abs(finer[1] - height) < 1e-4


def test_the_method_of_low_order_is_of_third_order():
    """Steps of the pair on a free flight: halving them divides the error by eight."""
    flight = loose.Flight(1.0, 1e-3, 1e-6)
    flight.t, flight.y, flight.slopes = flight.t[:1], flight.y[:1], flight.slopes[:1]
    exact = pyragas.returns().run({"x1": 2.0, "x2": 1.0})
    errors = []
    for h in (0.04, 0.02):
        end, _, _ = flight._try(h)
        errors.append(np.max(np.abs(end - np.array([exact(h, j=0).x1, exact(h, j=0).x2]))))
    assert 12.0 < errors[0] / errors[1] < 20.0  # one step: fourth order


def test_claims_that_need_no_table():
    """Their verdicts follow from the orbit, the border and Theorem 1."""
    assert control.uncontrolled().verdict is Verdict.REPRODUCED
    assert control.lag().verdict is Verdict.REPRODUCED
    assert control.conditions().verdict is Verdict.REPRODUCED


def test_verdicts_on_table_1(monkeypatch):
    """Not as it is written; mended by the restarted memory; with other rows another verdict."""
    monkeypatch.setattr(control, "STARTS", (2.5, 3.0))
    for claim in (control.controlled(), control.periods(), control.amplitudes()):
        assert claim.verdict is Verdict.CORRECTED
    monkeypatch.setattr(control, "STARTS", (2.1, 3.0))
    assert control.periods().verdict is Verdict.NOT_REPRODUCED
