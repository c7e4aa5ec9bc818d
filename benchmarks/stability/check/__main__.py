"""The command `python -m benchmarks.stability.check`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.stability import check
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code


def main(argv: Sequence[str] | None = None) -> int:
    """Run bodies through extreme states; return the exit code."""
    parser = Parser(
        prog="python -m benchmarks.stability.check",
        description="Try out the numerical stability: stiff bodies, large steps, impacts.",
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the runs")
    parser.add_argument("--out", default="out", metavar="FOLDER", help="of stability.csv (default %(default)s)")
    arguments = parser.parse_args(argv)
    return check.main(Path(arguments.out), arguments.quick)


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
