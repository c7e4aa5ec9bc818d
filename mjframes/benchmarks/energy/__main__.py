"""The command `python -m mjframes.benchmarks.energy`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mjframes.benchmarks.energy import QUICK, Plan, main, subjects
from mjframes.benchmarks.energy.bodies import MESHES, METHODS

BODIES, FEW = 40, 4  # drawn bodies, and with --quick

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m mjframes.benchmarks.energy", description="Look for energy that comes from nothing."
    )
    parser.add_argument("--bodies", type=int, metavar="N", help=f"how many are drawn (default: {BODIES})")
    parser.add_argument("--quick", action="store_true", help=f"{FEW} bodies, one step, no meshes: within two minutes")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (default: %(default)s)")
    parser.add_argument("--laws", nargs="+", choices=METHODS, default=METHODS, metavar="LAW", help=", ".join(METHODS))
    parser.add_argument("--out", default="out", metavar="FOLDER", help="of CSV and picture (default: %(default)s)")
    given = parser.parse_args()
    count = given.bodies if given.bodies is not None else FEW if given.quick else BODIES
    if not given.quick and not MESHES.is_dir():
        print(f"There are no meshes in {MESHES}; the drawn bodies are measured alone.", file=sys.stderr)
    chosen = subjects(count, given.seed, given.laws, meshes=not given.quick)
    sys.exit(main(chosen, QUICK if given.quick else Plan(), Path(given.out)))
