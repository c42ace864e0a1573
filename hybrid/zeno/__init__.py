"""Accumulations: infinitely many jumps in a finite time, detected, summed and passed."""

from .accumulate import Tail, close

__all__ = ["Tail", "close"]
