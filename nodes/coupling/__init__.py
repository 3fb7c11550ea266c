"""One block of the virtual coupling V: sees x and f_v of its own ports and nothing else.

Read ``core`` (the pure step), then ``block`` (its side towards the environment) and ``node`` (the loop).
"""
