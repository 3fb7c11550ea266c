"""What is done with recordings of runs: written at a run's end, read, checked, converted, replayed, audited, drawn."""
