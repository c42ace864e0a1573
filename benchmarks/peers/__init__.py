"""The Pyragas system with impacts, solved without hybrid: by other libraries and by hand."""
