"""The exception for errors that a user can cause."""


class UserError(Exception):
    """Bad input: one line that names the file or value, what is wrong with it and what would be right."""
