"""Delays: the history before a run, the record of its past, and the delayed terms of its flows."""
