"""Options of the command line that are the fields of a dataclass, see `base.options`."""

from __future__ import annotations

import argparse
from dataclasses import MISSING, Field
from typing import Any

from mjframes.base.options import Option, default_text, options_of


def spoken(kind: type) -> list[tuple[Field[Any], Option]]:
    """Return the options that a text can say."""
    return [(some, said) for some, said in options_of(kind) if said.reads or said.choices]


def add_options(command: argparse._ActionsContainer, kind: type) -> None:
    """Add an option a field, and one for each field of what a choice may be given as."""
    instead = {said.instead_of for _, said in options_of(kind)}
    exclusive = {name: command.add_mutually_exclusive_group() for name in instead if name}
    for some, said in spoken(kind):
        group = exclusive.get(said.instead_of or some.name, command)
        _add(group, some, said, [] if said.repeated else some.default)
        for own_kind in said.kinds.values():
            for own, of_kind in spoken(own_kind):
                _add(command, own, of_kind, None)


def _add(command: argparse._ActionsContainer, some: Field[Any], said: Option, default: object) -> None:
    shown = "" if said.repeated else default_text(some)
    command.add_argument(
        f"--{some.name.replace('_', '-')}",
        type=said.reads or str,
        action="append" if said.repeated else "store",
        choices=said.choices or None,
        required=some.default is MISSING,
        default=None if default is MISSING else default,
        metavar=said.metavar,
        help=(said.help + (f" (default {shown})" if shown else "")).replace("%", "%%"),
    )
