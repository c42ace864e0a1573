"""Whole runs as compiled programs: events, resets, accumulations and rest included.

``system``
    A class's functions for any mode and any contacts held.
``roots``, ``turn``, ``tail``
    The rules: the zeros of guards, one step or jump, the sum of a series of impacts.
``lanes``
    The loops around them.
"""
