"""Fixtures of the whole suite that these tests share."""

from tests.conftest import _memory_is_given_back, _rules_are_compiled, reference

__all__ = ["_memory_is_given_back", "_rules_are_compiled", "reference"]
