"""Sphinx's configuration: `make docs` writes build/docs. Nothing is fetched when a page is read."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]

project = "mjframes"
html_title = "mjframes"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_design"]
html_static_path = ["_pictures"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
html_theme = "pydata_sphinx_theme"
html_theme_options = {"show_toc_level": 2, "navigation_with_keys": False, "show_prev_next": True}
html_sidebars = {"**": []}  # all pages are in the head
html_show_copyright = False
html_math_renderer = "mathml"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_class_signature = "separated"
python_use_unqualified_type_names = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types of NumPy, MuJoCo, Python in signatures: their pages are not looked up

# What is documented beside the code is read here as well.
PAGES_ELSEWHERE = {
    "../plugin/README.md": "plugin.md",
    "../mjframes/README.md": "package.md",
    "../README.md": "index.md",
}


def setup(app: Any) -> None:
    """Draw the gallery, whose folder must be there before Sphinx looks for it; register what Sphinx calls."""
    draw_gallery(Path(app.srcdir))
    app.add_html_math_renderer("mathml", (write_inline, None), (write_block, None))
    app.connect("include-read", lambda app, path, document, content: relink(content))
    app.connect("source-read", lambda app, document, content: relink(content))
    app.connect(
        "autodoc-process-docstring", lambda app, what, name, thing, options, lines: as_text(lines), 400
    )  # before napoleon


def write_inline(translator: Any, node: nodes.math) -> None:
    """Write a formula as MathML, which browsers draw by themselves."""
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def write_block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula in a line of its own."""
    formula = tex2mathml(node.astext(), as_block=True)
    translator.body.append(f'<div style="margin: 1.2em 0; padding: .4em; overflow-x: auto">{formula}</div>')
    raise nodes.SkipNode


def draw_gallery(source: Path) -> None:
    """Draw the examples' pictures and films where they are not there yet."""
    from pictures import draw

    draw(source / "_pictures")


def relink(content: list[str]) -> None:
    """Point links between files of the repository at the pages that show them."""
    for file, page in PAGES_ELSEWHERE.items():
        content[0] = content[0].replace(f"]({file})", f"]({page})")
    content[0] = content[0].replace("](../docs/", "](")


def as_text(lines: list[str]) -> None:
    """Turn a docstring of plain text into reStructuredText, a list item for each 'name: …' at the start of a line.

    Sections of numpydoc, as "Parameters", are left to napoleon.
    """
    text: list[str] = []
    after_blank, in_sections = True, False
    for line in lines:
        item = re.match(r"^[a-z_]\w*(?: \[[^]]*\])?(?:, [a-z_]\w*(?: \[[^]]*\])?)*: ", line)
        drawn = escaped(line)
        if item and text and not after_blank and not text[-1].startswith(("- ", "  ")):
            text.append("")
        if re.fullmatch("-{3,}", line):
            in_sections = True
        if in_sections:
            text.append(line[: len(line) - len(line.lstrip())] + escaped(line.lstrip()))
            continue
        if line.startswith("    ") and after_blank:
            text += ["::", ""]
        if item:
            drawn = f"- {drawn}"
        elif line.startswith("    "):
            drawn = line
        elif line and not after_blank and text and text[-1].startswith(("- ", "  ")):
            drawn = f"  {drawn}"
        text.append(drawn)
        after_blank = not line
    lines[:] = text


def escaped(line: str) -> str:
    """Let only backticks mean something, and that what they enclose is code."""
    parts = re.sub("`+", "`", line).split("`")
    plain = [re.sub(r"([*|]|_(?!\w))", r"\\\1", part) for part in parts[::2]]
    code = [f"``{part}``" for part in parts[1::2]]
    return "".join(one for pair in zip(plain, [*code, ""], strict=False) for one in pair)
