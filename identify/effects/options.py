"""Reading of option tables ``[model.<effect>]``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from identify.errors import InputError

__all__ = ["check_keys", "is_number", "number"]


def check_keys(effect: str, options: Mapping[str, Any], *allowed: str) -> None:
    """Refuse options that nobody would read.

    Raises:
        InputError: A key that is not among the allowed ones.
    """
    for key in options:
        if key not in allowed:
            raise InputError(f"[model.{effect}] {key}: unknown key; allowed: {', '.join(allowed) or 'none'}")


def number(effect: str, options: Mapping[str, Any], key: str, default: float, *, least: float = -np.inf) -> float:
    """A number among the options.

    Raises:
        InputError: It is no number, or not above ``least``.
    """
    value = options.get(key, default)
    if not is_number(value) or not least < value < np.inf:
        bound = f" above {least:g}" if np.isfinite(least) else ""
        raise InputError(f"[model.{effect}] {key} = {value!r}: a finite number{bound} expected")
    return float(value)


def is_number(value: object) -> bool:
    """True for a number that is not nan (true and false are none)."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and not np.isnan(value)
