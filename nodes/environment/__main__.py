"""``python -m manyhands.nodes.environment BUNDLE SUPERVISOR_PID``."""

import sys

from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.bundle import EnvironmentBundle
from manyhands.nodes.link.process import main
from manyhands.protocol.transport.zeromq import await_links

if __name__ == "__main__":
    sys.exit(main(EnvironmentBundle, lambda bundle: EnvironmentNode(bundle, await_links=await_links)))
