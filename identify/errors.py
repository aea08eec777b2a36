"""The project's exceptions: one root and four kinds, each with its exit code.

A message names the file, key or line, the value, what is allowed and what to do.
"""

from __future__ import annotations

__all__ = ["ElastocalError", "Infeasible", "InputError", "NoConvergence", "NotIdentifiable"]


class ElastocalError(Exception):
    """Root of every error that elastocal raises on purpose."""

    exit_code = 1


class InputError(ElastocalError):
    """The input is wrong: a file, a key, a shape or a value."""

    exit_code = 2


class NotIdentifiable(ElastocalError):
    """The data or the candidates cannot show what is asked for.

    Attributes:
        missing: Names (or column numbers) of what cannot be seen.
    """

    exit_code = 3

    def __init__(self, message: str, missing: tuple[object, ...] = ()) -> None:
        """Keep the message and the names of what is missing."""
        super().__init__(message)
        self.missing = missing


class Infeasible(ElastocalError):
    """The constraints leave nothing to choose from."""

    exit_code = 3


class NoConvergence(ElastocalError):
    """An iteration stopped before its goal.

    Attributes:
        best: The best result found until then.
    """

    exit_code = 3

    def __init__(self, message: str, best: object = None) -> None:
        """Keep the message and the best result."""
        super().__init__(message)
        self.best = best
