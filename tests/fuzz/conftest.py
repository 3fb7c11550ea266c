"""The harnesses import each other by their plain names, as they do when the fuzzer runs them."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
