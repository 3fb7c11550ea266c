"""Somebody who looks on: reads what its session lists for it, and writes nothing."""
