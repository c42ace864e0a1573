"""Infinitely many jumps in a finite time: found, summed, left behind."""

from .accumulate import Tail, close

__all__ = ["Tail", "close"]
