"""One block of the virtual coupling V: sees x and f_v of its own ports and nothing else."""
