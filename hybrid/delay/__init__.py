"""The past of a run: what was before it, the record of it, and what its flows see of it."""
