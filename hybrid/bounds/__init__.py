"""Readers of the trace that prove something: bounds of expressions and of errors, rounded
outward."""
