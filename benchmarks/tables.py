"""How benchmarks show what they measured: tables for the terminal, in Markdown and as CSV, and the machine."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mjframes.base.files import replacing


def screen() -> Console:
    """Return where tables are printed."""
    console = Console()
    if not console.is_terminal:
        console.width = 200  # tables are as wide as they need; a pipe's 80 columns would break them
    return console


@contextmanager
def advancing(what: str, total: int) -> Iterator[tuple[Console, Callable[..., None]]]:
    """Show on a terminal's stderr how much is done.  Yield where else to print there, and what tells of a step, or of
    so many.
    """
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total)
        yield console, lambda steps=1: progress.advance(task, steps)


def show(console: Console, table: Table, note: str = "") -> None:
    """Print a table, and what is to be said of it."""
    console.print()
    console.print(table)
    if note:
        console.print(note, highlight=False)


def table_of(title: str, *columns: str) -> Table:
    """Return an empty table without lines, whose first column names its rows."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def markdown_table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> Iterable[str]:
    """Yield the lines of a table."""
    yield f"| {' | '.join(head)} |"
    yield f"|{' --- |' * len(head)}"
    yield from (f"| {' | '.join(line)} |" for line in lines)


def write_table(path: Path, columns: Sequence[str], rows: Sequence[tuple[object, ...]]) -> None:
    """Write rows of numbers below the names of their columns (.csv)."""
    with replacing(path, "the table") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([columns, *rows])


def machine() -> dict[str, str]:
    """Return what the numbers depend on: processor, what else it does, system, versions."""
    packages = ("mujoco", "numpy", "scipy", "numba")
    return {
        "processor": f"{_processor()}, {os.cpu_count()} cores, of which steps use one",
        "load": f"{os.getloadavg()[0]:.1f} cores busy in the last minute",
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "versions": ", ".join(f"{name} {version(name)}" for name in packages),
    }


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"
