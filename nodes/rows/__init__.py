"""What a node reports: the names of its figures and traces (``telemetry``), its events, and which ticks are its own."""
