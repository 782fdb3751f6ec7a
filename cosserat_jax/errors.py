"""What a user did wrong, each in one line. Imports nothing that takes time: the command line answers typos at once."""

import difflib


class SceneError(ValueError):
    """Something a user wrote cannot be a scene: one line that names the place, the value and what is allowed."""


class OutputError(ValueError):
    """An output cannot be written: one line that names the option, the file and what is allowed."""


def nearest(word: str, known: list[str]) -> str:
    """A hint for a word that is not known: the nearest known one, or all of them."""
    close = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {close[0]!r}?" if close else "allowed: " + ", ".join(known)
