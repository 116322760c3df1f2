"""The exception for errors that a user can cause."""


class UserError(Exception):
    """Bad input: one line that names the file or value, what is wrong with it and what would be right."""


def one_line(error: BaseException | str) -> str:
    """What an error says, short and in one line, for a message that names the file itself."""
    said = getattr(error, "strerror", None) or str(error) or type(error).__name__
    # A file's content may be part of it.
    line = "".join(c if c.isprintable() else " " for c in said)
    return line if len(line) <= 300 else f"{line[:300]}..."
