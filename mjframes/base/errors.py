"""The one exception that a user's mistake raises, and the warnings of what was taken for granted."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class MjframesError(ValueError):
    """A mistake in the input. The message is one sentence: the argument or file, what is wrong, what would be right."""


class Notice(UserWarning):
    """The input is incomplete or unusual, and a default was assumed; the command line prints it."""


def telling_memory(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function with a MjframesError in place of a MemoryError."""

    @functools.wraps(function)
    def told(*arguments: P.args, **options: P.kwargs) -> R:
        try:
            return function(*arguments, **options)
        except MemoryError as error:
            raise MjframesError(out_of_memory(error)) from error

    return told


def reason(error: BaseException) -> str:
    """Return what a foreign error says, for the brackets of a sentence: on one line, without a full stop at its end."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def out_of_memory(error: MemoryError) -> str:
    """Return the sentence on it."""
    told = f" ({error})" if str(error) else ""
    return f"there is not enough memory{told}; take fewer voxels, as with --voxels, or fewer frames."
