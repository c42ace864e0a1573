"""``python -m hybrid``."""

from .cli import main

main()
