"""Sessions under faults, simulated: the kinds of faults are those of the benchmark that does them to real processes."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
