"""Couplings that a user feels least: the weighted norm that is minimised, over families of couplings.

Read ``design`` first (what is asked and answered), then ``families`` (the couplings), ``minimax`` (the program for
fixed poles), and ``free_poles`` with ``pole_search`` (poles that move).
"""
