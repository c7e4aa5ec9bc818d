"""The one exception that a user's mistake raises."""


class MjframesError(ValueError):
    """One sentence that names the argument or file, what is wrong with it and what would be right."""
