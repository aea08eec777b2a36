"""Reading of option tables ``[model.<effect>]``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from identify.errors import InputError

__all__ = ["check_keys", "chosen_components", "is_number", "number"]


def check_keys(effect: str, options: Mapping[str, Any], *allowed: str) -> None:
    """Refuse options that nobody would read.

    Raises:
        InputError: A key that is not among the allowed ones.
    """
    for key in options:
        if key not in allowed:
            known = f"allowed: {', '.join(allowed)}" if allowed else "this effect has no options"
            raise InputError(f"[model.{effect}] {key}: unknown key; {known}")


def number(effect: str, options: Mapping[str, Any], key: str, default: float, *, least: float = -np.inf) -> float:
    """A number among the options; the default where it is not given.

    Raises:
        InputError: It is no number, or not above ``least``.
    """
    if key not in options:
        return default
    value = options[key]
    if not is_number(value) or not least < value < np.inf:
        bound = f" above {least:g}" if np.isfinite(least) else ""
        raise InputError(f"[model.{effect}] {key} = {value!r}: a finite number{bound} expected")
    return float(value)


def is_number(value: object) -> bool:
    """True for a number that is not nan (true and false are none)."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and not np.isnan(value)


def chosen_components(
    effect: str, options: Mapping[str, Any], allowed: tuple[str, ...], default: tuple[str, ...]
) -> tuple[str, ...]:
    """The option ``components``, the only one of the effect, in the order of ``allowed``.

    Raises:
        InputError: It is no list of components, or there is another option.
    """
    check_keys(effect, options, "components")
    chosen = options.get("components", default)
    if isinstance(chosen, list | tuple) and chosen and all(item in allowed for item in chosen):
        return tuple(item for item in allowed if item in chosen)
    raise InputError(f"[model.{effect}] components = {chosen!r}: a list of {', '.join(allowed)} expected")
