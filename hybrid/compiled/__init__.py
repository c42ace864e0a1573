"""Whole runs as compiled programs: events, resets, accumulations and rest included.

``system``
    A class's functions for any mode and any contacts held.
``lane``, ``roots``, ``detect``, ``turn``, ``tail``
    The rules: one trajectory on its way, the zeros of guards, the first event of a step, one
    step or jump, the sum of a series of impacts.
``lanes``
    The loops around them: a whole trajectory.
``ask``
    What a caller gives, as arrays.
"""
