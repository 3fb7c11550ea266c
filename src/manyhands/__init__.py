"""Many hands, one virtual world, and a proof that it is stable.

Four rooms, imported one way (``design | protocol`` <- ``nodes`` <- ``launch``):

* :mod:`manyhands.design`: models, passivity, LMIs, couplings, certificates;
* :mod:`manyhands.protocol`: what crosses a process border;
* :mod:`manyhands.nodes`: the device, coupling and environment processes;
* :mod:`manyhands.launch`: session files, the supervisor, the command line.
"""

__version__ = "0.6.0"
