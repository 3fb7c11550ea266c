"""Suites that every driver and every model has to pass, for the tests and for ``check-driver`` and ``check-model``."""
