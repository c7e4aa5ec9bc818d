"""Options that are declared once, as fields of a dataclass: signature, docstring, command line and docs are read off.

@dataclass(frozen=True)
class Toast:
    slices: int = field(default=2, metadata=option("how many", reads=count, metavar="N"))

@taking(Toast)
def toast(options: Toast) -> Bread: ...

toast(slices=3)
"""

from __future__ import annotations

import difflib
import functools
import inspect
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Any, ParamSpec, TypeVar

from mjframes.base.errors import MjframesError

P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Option:
    """What is said of a field.

    help: what it is, with its unit and the default where that is None; no full stop.
    choices: the names that it may be.
    many: whether a sequence of names may be given, too.
    kinds: of some names a dataclass that may be given in place of the name, with options of its own.
    reads: makes a value of a text. Without it and without choices the command line has no such option.
    metavar: what stands for the value there.
    instead_of: the option besides which it may not be given there.
    repeated: whether it may be given several times there.
    """

    help: str
    choices: tuple[str, ...] = ()
    many: bool = False
    kinds: Mapping[str, type] = field(default_factory=dict)
    reads: Callable[[str], Any] | None = None
    metavar: str | None = None
    instead_of: str | None = None
    repeated: bool = False


def option(help: str, **more: Any) -> dict[str, Option]:
    """Return the metadata of a field. more: see `Option`."""
    return {"option": Option(help, **more)}


def options_of(kind: type) -> list[tuple[Field[Any], Option]]:
    """Return the fields of a dataclass that are options, in their order."""
    return [(some, some.metadata["option"]) for some in fields(kind) if "option" in some.metadata]


def require_choices(options: Any) -> None:
    """Raise MjframesError for the first option that is none of the names it has to be; None may be where that is the
    default. Those that may be more than a name, of some `kinds` or a sequence, are for their own stage to check.
    """
    for some, said in options_of(type(options)):
        value = getattr(options, some.name)
        choices = ((None,) if some.default is None else ()) + said.choices
        if said.choices and not (said.kinds or said.many) and value not in choices:
            raise MjframesError(f"{some.name} is {value!r}; it must be one of {', '.join(map(repr, choices))}.")


def taking(options: Callable[P, T]) -> Callable[[Callable[[T], R]], Callable[P, R]]:
    """Return a decorator: the function is called with the arguments of a dataclass, in place of an instance of it.

    It raises MjframesError for arguments that the dataclass does not take.
    """
    signature = inspect.signature(options)

    def decorate(function: Callable[[T], R]) -> Callable[P, R]:
        @functools.wraps(function)
        def called(*arguments: P.args, **named: P.kwargs) -> R:
            _require_known(function.__name__, named, list(signature.parameters))
            try:
                signature.bind(*arguments, **named)
            except TypeError as error:
                raise MjframesError(
                    f"{function.__name__}: {error}; it takes {', '.join(signature.parameters)}."
                ) from error
            return function(options(*arguments, **named))

        result = inspect.signature(function).return_annotation
        called.__dict__["__signature__"] = signature.replace(return_annotation=result)
        if isinstance(options, type):
            before, raises, after = str(inspect.getdoc(function)).partition("\nRaises\n")
            called.__doc__ = f"{before.rstrip()}\n\n{listed(options)}\n{raises}{after}".rstrip()
        return called

    return decorate


def _require_known(function: str, given: Iterable[str], known: Sequence[str]) -> None:
    """Raise MjframesError for the first name that is none of an option, with the one that is most alike."""
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            right = f"did you mean {near[0]}?" if near else f"it has {', '.join(known)}."
            raise MjframesError(f"{function} has no option {name}; {right}")


def listed(kind: type) -> str:
    """Return the options of a dataclass as the section "Parameters" of a docstring."""
    lines = ["Parameters", "----------"]
    for some, said in options_of(kind):
        text = described(some, said)
        sentence = textwrap.wrap(f"{text[0].upper()}{text[1:]}.", 112, break_on_hyphens=False)
        lines += [some.name, *(f"    {line}" for line in sentence)]
    return "\n".join(lines)


def described(some: Field[Any], said: Option) -> str:
    """Return what an option is, with its choices."""
    names = [f'"{name}"' for name in said.choices]
    for kind in said.kinds.values():
        if own := ", ".join(one.name for one, _ in options_of(kind)):
            names.append(f"mf.{kind.__name__}({own})")
    return said.help + (f"; {', '.join(names[:-1])} or {names[-1]}" if names else "")


def default_text(some: Field[Any]) -> str:
    """Return how the default is written on the command line, "" where there is none."""
    value = some.default
    if value is None or value is MISSING:
        return ""
    return ",".join(f"{part:g}" for part in value) if isinstance(value, tuple) else str(value)
