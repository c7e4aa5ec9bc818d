"""Bodies to measure, and their solutions by finite elements."""

from __future__ import annotations

from pathlib import Path

SOURCES = tuple(sorted(Path(__file__).parent.glob("*.py")))  # solutions that are kept depend on them
