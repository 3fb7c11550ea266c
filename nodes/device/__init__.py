"""A force-feedback device: samples x, applies f_v, paces the loop."""
