"""``python -m manyhands.nodes.coupling BUNDLE SUPERVISOR_PID``."""

import sys

from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.kernel.bundle import CouplingBundle
from manyhands.nodes.link.process import main

if __name__ == "__main__":
    sys.exit(main(CouplingBundle, CouplingNode))
