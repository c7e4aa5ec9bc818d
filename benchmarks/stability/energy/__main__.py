"""The command `python -m benchmarks.stability.energy`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.stability import energy
from benchmarks.stability.energy import QUICK, Plan, subjects
from benchmarks.stability.energy.bodies import MESHES, METHODS
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code

BODIES, FEW = 40, 4  # drawn bodies, and with --quick


def main(argv: Sequence[str] | None = None) -> int:
    """Look for energy that comes from nothing; return the exit code."""
    parser = Parser(
        prog="python -m benchmarks.stability.energy", description="Look for energy that comes from nothing."
    )
    parser.add_argument("--bodies", type=int, metavar="N", help=f"how many are drawn (default: {BODIES})")
    parser.add_argument("--quick", action="store_true", help=f"{FEW} bodies, one step, no meshes: within two minutes")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (default: %(default)s)")
    parser.add_argument("--laws", nargs="+", choices=METHODS, default=METHODS, metavar="LAW", help=", ".join(METHODS))
    parser.add_argument("--out", default="out", metavar="FOLDER", help="of energy.csv (default: %(default)s)")
    given = parser.parse_args(argv)
    count = given.bodies if given.bodies is not None else FEW if given.quick else BODIES
    if not given.quick and not MESHES.is_dir():
        print(f"There are no meshes in {MESHES}; the drawn bodies are measured alone.", file=sys.stderr)
    chosen = subjects(count, given.seed, given.laws, meshes=not given.quick)
    return energy.main(chosen, QUICK if given.quick else Plan(), Path(given.out))


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
