"""Pure mathematics: models, passivity, LMIs, couplings, certificates. No sockets, no clocks."""
