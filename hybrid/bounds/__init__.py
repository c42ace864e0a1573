"""Rigorous bounds, rounded outward, on traced expressions and on the errors of steps."""
