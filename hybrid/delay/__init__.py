"""Delays: the history before a run, the record of its past, and what its flows see of it."""
