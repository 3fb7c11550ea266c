"""The shared virtual environment E: sees tool positions p and D_V, never x."""
