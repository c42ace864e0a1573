"""The paper from end to end: its claims, our figures beside them, and the verdicts.

*Analysis of Impact Chattering* (Akhmet & Çağ). A module for each of its sections holds a function
``section()``, which runs the models of the gallery and returns a :class:`~.claims.Section`;
``page`` writes them all as one page of HTML that needs no network. Whatever is ours is computed
in that run; only the paper's own words and numbers are typed in.
"""
