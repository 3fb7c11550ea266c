"""What a node reports: its figures (``figures``), its events, its promises, and which ticks are its own."""
