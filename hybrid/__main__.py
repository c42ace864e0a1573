"""``python -m hybrid``."""

from .cli import app

app()
