"""The one exception that a user's mistake raises, and the warnings of what was taken for granted."""


class MjframesError(ValueError):
    """One sentence that names the argument or file, what is wrong with it and what would be right."""


class Notice(UserWarning):
    """One sentence on what a file does not say or is not, and how it was taken; the command line prints it."""
