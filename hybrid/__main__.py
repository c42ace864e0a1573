"""``python -m hybrid``."""

from .cli.app import app

app()
