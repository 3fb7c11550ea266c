"""Who writes a run down: a process of its own, so that neither a slow nor a full disk reaches the loop."""
