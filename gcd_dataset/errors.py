"""The exceptions of this package.

Messages are one line: file or object, fault, remedy. ``gcd`` prints them unchanged.
"""

from collections.abc import Iterable

__all__ = [
    "BodyError", "ConfigError", "DrapeError", "ExtraMissing", "FitError", "GcdError", "MeshError", "MissingError",
    "OutputError", "PatternError", "RefusedError", "RemoteError", "ShardError", "SpecError", "TransformError",
    "did_you_mean", "shown",
]  # fmt: skip

JOINERS = dict.fromkeys(map(ord, "\xa0\u2009\u200c\u200d\u200e\u200f\u202f\u3000"))
"""Spaces and joiners in words of some scripts and in emoji, which ``str.isprintable`` refuses."""


LONGEST = 4000  # characters of a message


def shown(text: str) -> str:
    """The text for a message: unchanged if printable, else quoted and escaped.

    >>> shown("train"), shown("a\\nb")
    ('train', "'a\\\\nb'")
    """
    return text if text.translate(JOINERS).isprintable() else ascii(text)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown word: the most similar known word, if there is one.

    >>> did_you_mean("drap", ["body", "drape"]), did_you_mean("xyz", ["body"])
    (': did you mean drape?', '')
    """
    import difflib  # slow to import, and needed for errors only

    nearest = difflib.get_close_matches(word, list(known), 1)
    return f": did you mean {nearest[0]}?" if nearest else ""


class GcdError(Exception):
    """Base of all errors of this package; the message is one line: control characters are escaped.

    >>> str(GcdError("split a\\nb is empty"))
    'split a\\\\nb is empty'
    """

    def __init__(self, *message: object) -> None:
        super().__init__(*(_one_line(part) if isinstance(part, str) else part for part in message))


def _one_line(text: str) -> str:
    """The text with unprintable characters, line breaks included, as escapes; the middle of a long one is left out."""
    if len(text) > LONGEST:  # a name in a file may have megabytes
        text = f"{text[: LONGEST // 2]} … {text[-LONGEST // 2 :]}"
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


class SpecError(GcdError):
    """A specification file that cannot be read."""


class PatternError(GcdError):
    """A pattern that cannot be sewn."""


class FitError(PatternError):
    """A curve that cannot meet its length or tangent; the message holds the residual."""


class BodyError(GcdError):
    """A body that cannot be used or measured."""


class MeshError(GcdError):
    """A panel that cannot be meshed, or a seam that cannot be merged."""


class DrapeError(GcdError):
    """A drape that cannot start."""


class ShardError(GcdError):
    """A data set on disk that is broken, foreign or too new."""


class RemoteError(ShardError):
    """A server that does not answer, refuses, or sends other bytes than were published."""


class MissingError(RemoteError):
    """A file or repository that the server does not have."""


class RefusedError(RemoteError):
    """A file or repository that the server denies access to with this token."""


class ConfigError(GcdError):
    """Options that contradict each other, or that this machine cannot serve: a missing GPU or package."""


class ExtraMissing(ConfigError):  # noqa: N818 -- the state of the installation
    """A library of an extra that is not installed; the message holds the command that installs it."""


class TransformError(GcdError):
    """A transform that raised on a garment; ``__cause__`` is the original error."""


class OutputError(GcdError):
    """A file or folder that cannot be written."""
