"""Tables of the documentation that the code has: `python docs/tables.py` writes them into the pages."""

from __future__ import annotations

import re
from pathlib import Path

from mjframes.base.options import described, options_of
from mjframes.body.options import BuildOptions
from mjframes.elasticity.law_table import LAWS
from mjframes.scene.sensors import QUANTITIES
from mjframes.volume.images import IMAGE_TYPES
from mjframes.volume.meshes import MESH_TYPES

FOLDER = Path(__file__).parent


def options_of_build() -> str:
    """Return the options of `mf.build` as a table."""
    rows = [f"| `{some.name}` | {_coded(described(some, said))} |" for some, said in options_of(BuildOptions)]
    return "\n".join(["| argument | what it is |", "| --- | --- |", *rows])


def laws() -> str:
    """Return the hyperelastic laws and their constants as a table."""
    rows = [f"| `{name}` | {', '.join(f'`{constant}`' for constant in law.names)} |" for name, law in LAWS.items()]
    return "\n".join(["| law | constants |", "| --- | --- |", *rows])


def sensors() -> str:
    """Return what a sensor can measure as a table."""
    rows = [
        f"| `{name}` | {one.what} | {one.unit} | {one.values}{' per point' if one.reads else ''} |"
        for name, one in QUANTITIES.items()
    ]
    return "\n".join(["| quantity | what it is | unit | values |", "| --- | --- | --- | --- |", *rows])


def volume_formats() -> str:
    """Return the files that a volume is made of as a table."""
    kinds = {"label images": IMAGE_TYPES, "meshes": MESH_TYPES}
    rows = [f"| {kind} | {' '.join(f'`{name}`' for name in names)} |" for kind, names in kinds.items()]
    return "\n".join(["| files | types |", "| --- | --- |", *rows])


TABLES = {
    ("options.md", "options"): options_of_build,
    ("options.md", "laws"): laws,
    ("scenes.md", "sensors"): sensors,
    ("volumes.md", "formats"): volume_formats,
}


def written(page: str, name: str, table: str) -> str:
    """Return the text of a page with that table between its marks."""
    begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
    before, after = (FOLDER / page).read_text(encoding="utf-8").split(begin)
    return f"{before}{begin}{table}\n{end}{after.partition(end)[2]}"


def _coded(text: str) -> str:
    """What is in quotes, or a name of mjframes, as code."""
    return re.sub(r'("\w[^"]*"|mf\.\w+\(\w*\))', r"`\1`", text)


if __name__ == "__main__":
    for (page, name), table in TABLES.items():
        (FOLDER / page).write_text(written(page, name, table()), encoding="utf-8")
