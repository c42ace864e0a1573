"""Pictures: what is drawn (``figure``, ``of_run``) apart from what draws it.

A :class:`~.figure.Figure` is curves and cells in panels, and nothing else. ``static`` draws it
with matplotlib, ``interactive`` with plotly; both show the same numbers in the same colours.
"""
