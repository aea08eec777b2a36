"""Which elements of a link's 6x6 compliance matrix are unknown: the options of `link_compliance`.

An element (a, b) is the deflection a per load b; 1 to 3 are along, 4 to 6 about local x, y, z.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from identify.errors import InputError

__all__ = [
    "BEAM",
    "FULL",
    "SYMMETRIC",
    "Elements",
    "check_link_options",
    "element_name",
    "link_constants",
    "link_template",
]

Elements = tuple[tuple[int, int], ...]

#: A beam along local x: Klimchik, Caro, Furet, Pashkevich, "Complete Stiffness Model for a Serial Robot", eq. 13.
BEAM: Elements = ((1, 1), (2, 2), (3, 3), (4, 4), (5, 5), (6, 6), (2, 6), (3, 5))
SYMMETRIC: Elements = tuple((i, j) for i in range(1, 7) for j in range(i, 7))
FULL: Elements = tuple((i, j) for i in range(1, 7) for j in range(1, 7))

_TEMPLATES = {"beam": BEAM, "symmetric": SYMMETRIC, "full": FULL}
_ALLOWED = f"allowed are {', '.join(_TEMPLATES)}, a list of k11 ... k66, or six rows of six zeros and ones"
_OWN_KEYS = ("template",)


def element_name(element: tuple[int, int]) -> str:
    """``k26`` for (2, 6)."""
    return f"k{element[0]}{element[1]}"


def link_template(options: Mapping[str, Any], link: int) -> Elements:
    """Elements of the compliance matrix of one link.

    A list names one element of each mirrored pair, which then is one parameter, or both of them. It may be empty:
    that link is rigid.

    Args:
        options: The table ``[model.link_compliance]``.
        link: Number of the link, 0 is the base.

    Raises:
        InputError: A template that does not exist, an element that is none of k11 ... k66, or no symmetric matrix.
    """
    own = options.get(f"link{link}", {})
    where = f"link{link} template" if "template" in own else "template"
    chosen = own.get("template", options.get("template", "beam"))
    if isinstance(chosen, str) and chosen in _TEMPLATES:
        return _TEMPLATES[chosen]
    found = _listed(chosen) if _is_list(chosen) else None
    if found is None:
        raise InputError(f"[model.link_compliance] {where} = {chosen!r}: {_ALLOWED}")
    _check_symmetric(found, f"[model.link_compliance] {where}", pattern=_is_matrix(chosen))
    return tuple(e for e in found if e[0] <= e[1]) if _is_matrix(chosen) else found


def check_link_options(options: Mapping[str, Any], links: int) -> None:
    """Refuse options that nobody would read.

    Args:
        options: The table ``[model.link_compliance]``.
        links: Number of links, base included.

    Raises:
        InputError: An unknown key, or a link that the robot does not have.
    """
    names = [f"link{number}" for number in range(links)]
    for key, value in options.items():
        if key in {"template", "constants"}:
            continue
        if key not in names:
            raise InputError(
                f"[model.link_compliance] {key}: no such option; allowed are template, constants and tables "
                f"{names[0]} ... {names[-1]}"
            )
        if not isinstance(value, Mapping) or any(name not in _OWN_KEYS for name in value):
            raise InputError(f"[model.link_compliance] {key} = {value!r}: a table with the key template expected")


def link_constants(options: Mapping[str, Any], links: int) -> dict[tuple[int, tuple[int, int]], float]:
    """Elements held at stated values, ``[model.link_compliance.constants] link2.k22 = 0.003``: in the units of results.

    Args:
        options: The table ``[model.link_compliance]``.
        links: Number of links, base included.

    Returns:
        (link, element) -> value; mirrored elements stand once, with a <= b.

    Raises:
        InputError: No table of numbers by ``link<i>.k<ab>``, or an element stated twice.
    """
    key, table = "[model.link_compliance.constants]", options.get("constants", {})
    if not isinstance(table, Mapping):
        raise InputError(f"{key}: a table such as link2.k22 = 0.003 expected")
    flat: dict[str, Any] = {}
    for name, value in table.items():
        inner = value.items() if isinstance(value, Mapping) else [("", value)]
        flat.update({f"{name}.{element}" if element else name: number for element, number in inner})
    places = {f"link{i}.{element_name((a, b))}": (i, (min(a, b), max(a, b))) for i in range(links) for a, b in FULL}
    found: dict[tuple[int, tuple[int, int]], float] = {}
    for name, value in flat.items():
        if name not in places or not isinstance(value, int | float) or places[name] in found:
            raise InputError(
                f"{key} {name} = {value!r}: a number for one of link0.k11 ... link{links - 1}.k66 expected, each once"
            )
        found[places[name]] = float(value)
    return found


def _is_list(chosen: object) -> bool:
    return isinstance(chosen, list | tuple)


def _is_matrix(chosen: Any) -> bool:
    return _is_list(chosen) and len(chosen) == 6 and all(_is_list(row) and len(row) == 6 for row in chosen)


def _listed(chosen: Any) -> Elements | None:
    """The elements that a list of names or a 6x6 pattern states; None if it is neither."""
    if _is_matrix(chosen):
        if any(entry not in (0, 1) for row in chosen for entry in row):
            return None
        return tuple((a, b) for a, b in FULL if chosen[a - 1][b - 1])
    names = {element_name(element): element for element in FULL}
    if all(isinstance(name, str) and name in names for name in chosen):
        return tuple(dict.fromkeys(names[name] for name in chosen))
    return None


def _check_symmetric(elements: Elements, key: str, *, pattern: bool) -> None:
    """Every mirrored element is there too, or (in a list of names) none is."""
    sides = [(a, b) for a, b in elements if a != b]
    alone = [(a, b) for a, b in sides if (b, a) not in sides]
    if alone and (pattern or len(alone) < len(sides)):
        a, b = alone[0]
        remedy = "" if pattern else "; name both of every mirrored pair, or one of each"
        raise InputError(
            f"{key}: not symmetric: it holds k{a}{b} and not k{b}{a}, but a compliance matrix is symmetric{remedy}"
        )
