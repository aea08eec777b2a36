"""Reading of the tables ``[model.<effect>]`` that several effects have in common."""

from __future__ import annotations

from identify.effects.base import Binding
from identify.errors import InputError

__all__ = ["check_options", "chosen_components"]


def check_options(name: str, binding: Binding, allowed: tuple[str, ...] = ()) -> None:
    """Refuse options that an effect does not have.

    Raises:
        InputError: A key that is not ``allowed``.
    """
    for key in binding.options:
        if key not in allowed:
            known = f"allowed: {', '.join(allowed)}" if allowed else "this effect has no options"
            raise InputError(f"[model.{name}] {key}: unknown key; {known}")


def chosen_components(
    name: str, binding: Binding, allowed: tuple[str, ...], default: tuple[str, ...]
) -> tuple[str, ...]:
    """The option ``components``, the only one of the effect, in the order of ``allowed``.

    Raises:
        InputError: It is no list of components, or there is another option.
    """
    check_options(name, binding, ("components",))
    chosen = binding.options.get("components", default)
    if isinstance(chosen, list | tuple) and chosen and all(item in allowed for item in chosen):
        return tuple(item for item in allowed if item in chosen)
    raise InputError(f"[model.{name}] components = {chosen!r}: a list of {', '.join(allowed)} expected")
