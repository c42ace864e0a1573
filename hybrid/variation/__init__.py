"""The first variation of a run: its dependence on start, parameters and times."""

from .carried import Carried
from .derivatives import Derivatives
from .growth import GROWN_APART, TRANSIENT, first_frame, grown, largest
from .past import PastVariation, Shift, Strand, descendants, distinct
from .slopes import Owned
from .walk import Course, Factor, Moment, Walk, factors, factors_of

__all__ = [
    "GROWN_APART",
    "TRANSIENT",
    "Carried",
    "Course",
    "Derivatives",
    "Factor",
    "Moment",
    "Owned",
    "PastVariation",
    "Shift",
    "Strand",
    "Walk",
    "descendants",
    "distinct",
    "factors",
    "factors_of",
    "first_frame",
    "grown",
    "largest",
]
