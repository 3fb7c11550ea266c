"""Transparent couplings, which a user feels least: a weighted norm is minimised over families of couplings.

Read ``design`` first (the problems and their answers), then ``families`` (the sets of couplings) and ``minimax`` (the
minimisation); ``free_poles`` and ``pole_search`` then let the poles move.
"""
