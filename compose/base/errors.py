"""The one exception that a user can cause."""


class UserError(Exception):
    """Bad input: one line that names the file or option, what is wrong and what would be right."""
