"""What a user did wrong, each in one line. Imports nothing that takes time: the command line answers typos at once."""

import difflib

_LONGEST, _KEPT = 600, 280  # characters of a message, and of each end of a longer one


class InputError(ValueError):
    """Something that was given cannot be used: one line that names the argument or path, says what it must be and what
    it is, and what to do. However long what was typed is, the line is not."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class OutputError(OSError):
    """An output could not be written, in one line."""


def one_line(message: str) -> str:
    """A message without line breaks, and the middle of a long one left out."""
    line = " ".join(message.split())
    return line if len(line) <= _LONGEST else f"{line[:_KEPT]} ... {line[-_KEPT:]}"


def quoted(value: object) -> str:
    """A value as a message quotes it: as it was typed, the middle of a long one left out."""
    try:
        text = repr(value)
    except ValueError:  # Python writes down no whole number of more than 4300 digits
        text = "a number of thousands of digits"
    return text if len(text) <= 80 else f"{text[:38]} ... {text[-37:]}"


def nearest(word: str, known: list[str]) -> str:
    """A hint for a word that is not known: the nearest known one, or all of them."""
    close = difflib.get_close_matches(word[:80], known, n=1)
    return f"did you mean {close[0]!r}?" if close else "allowed: " + ", ".join(known)
