"""Looking things up in a section of the report."""


def claim_that(section, part):
    """The one claim that says this."""
    (found,) = [claim for claim in section.claims if part in claim.says]
    return found


def number(claim, what):
    """The first of a claim's numbers whose name begins so."""
    return next(number for number in claim.numbers if number.what.startswith(what))
