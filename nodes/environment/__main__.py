"""``python -m manyhands.nodes.environment BUNDLE SUPERVISOR_PID``."""

import sys

from manyhands.nodes.bundle import EnvironmentBundle
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.process import main

if __name__ == "__main__":
    sys.exit(main(EnvironmentBundle, EnvironmentNode))
