"""Rigorous readers of the trace: outward-rounded bounds on expressions and on errors."""
