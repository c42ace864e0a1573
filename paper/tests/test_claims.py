"""Verdicts and digits are decided by numbers."""

import pytest

from paper import SECTIONS, report
from paper.claims import Verdict, rounds_to, shown, verdict


def test_verdicts():
    """As printed; mended; not at all."""
    assert verdict(True) is Verdict.REPRODUCED
    assert verdict(False, mended=True) is Verdict.CORRECTED
    assert verdict(False) is Verdict.NOT_REPRODUCED


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.32961738383844857, 2e-13, "1.3296173838384 ± 2e-13"),
        (1.32961738383844857, 3e-16, "1.329617383838449 ± 3e-16"),
        (4.2e-85, 1e-96, "4.20000000000e-85 ± 1e-96"),
        (19.19289834649200, 4e-12, "19.192898346492 ± 4e-12"),
        (123.456, None, "123.456"),
        (18, None, "18"),
        (0.0, 0.0, "0"),
        (0.0, 1e-12, "0 ± 1e-12"),
        (1234567.0, 20.0, "1234567 ± 2e+01"),
        ("rests", None, "rests"),
    ],
)
def test_digits_are_shown_as_far_as_they_are_known(value, error, text):
    """No more than the error leaves, nor than a double holds."""
    assert shown(value, error) == text


def test_rounding_to_what_is_printed():
    """A comma is a point; all digits count."""
    assert rounds_to(6.28366, "6.28")
    assert rounds_to(2.91496, "2,91")
    assert not rounds_to(2.935716, "2.933")
    assert rounds_to(-16.625, "-16.625")


def test_a_section_that_is_not_there(tmp_path):
    """Its name is told, with those that are there."""
    from hybrid.errors import OptionError

    with pytest.raises(OptionError, match=f"'preface'.*{SECTIONS[0]}"):
        report(tmp_path, ["preface"])
