"""Settings of the documentation site; `tools/docs` builds it."""

import os
import sys
import tomllib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
tree = Path(os.environ["LPVGUARD_TREE"])
project = "lpvguard"
author = "the lpvguard authors"
copyright = "the lpvguard authors"
release = tomllib.loads((tree / "tools" / "pyproject.toml").read_text())["project"]["version"]
version = release
extensions = ["myst_parser", "extension"]
exclude_patterns = ["generated.py"]
root_doc = "index"
html_theme = "furo"
html_title = f"lpvguard {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it fetches pages, which a browser refuses to files
html_show_sourcelink = False
html_theme_options = {
    "light_css_variables": {"font-stack": "system-ui, sans-serif", "font-stack--monospace": "monospace"}
}
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
myst_enable_extensions = ["attrs_inline", "colon_fence"]
suppress_warnings = ["config.cache"]
