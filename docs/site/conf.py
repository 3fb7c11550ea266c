"""The documentation site: what the repository's Markdown says, searchable, with its links checked.

    make docs    # into out/docs/

The pages are read where they stand. What docs/site/ adds is the first page, and pages that are made of the code: public
names, commands and keys (generated.py); and what leads from page to page (reading.py).
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(Path(__file__).parent))  # for generated.py and reading.py

project = "manyhands"
author = "the manyhands authors"
found = re.search(r'__version__ = "(.*)"', (ROOT / "src/manyhands/__init__.py").read_text())
version = release = found[1] if found else ""

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "generated", "reading"]
autodoc_member_order = "bysource"
add_module_names = False
python_use_unqualified_type_names = True
napoleon_use_ivar = True
include_patterns = [
    "docs/**.md",
    "protocol/SPEC.md",
    "devices/*/PROTOCOL.md",
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
]
master_doc = root_doc = "docs/site/index"
myst_enable_extensions = ["deflist", "smartquotes"]
myst_heading_anchors = 4
html_theme = "furo"
html_show_copyright = False
html_title = f"manyhands {release}"
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types of signatures that have no page; links of pages are checked
