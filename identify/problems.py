"""Everything that is wrong with one TOML file, gathered into one error."""

from __future__ import annotations

import difflib
import math
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from identify.errors import InputError

__all__ = ["Problems", "name_robot_from", "nearest", "read_toml", "unknown"]

MAX_BYTES = 10_000_000

_SHOWN = 50  # problems of one file that a message holds

_M = TypeVar("_M", bound=BaseModel)

#: Tables inside tables: they get a heading of their own in messages.
_INNER_TABLES = {"tracker", "nominal", "values", "payload_diagram", "visibility"}
_INNER_LISTS = {"boxes", "walls"}  # and lists of tables inside tables

_TYPES = {
    "float_type": "a number expected",
    "int_type": "a whole number expected",
    "bool_type": "true or false expected",
    "string_type": "a text in quotes expected",
    "list_type": "a list expected",
    "dict_type": "a table expected",
    "model_type": "a table expected",
    "finite_number": "a finite number expected",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "allowed are letters, digits, '_', '.' and '-'",
    "missing": "is missing",
}


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        InputError: The file cannot be read, is too big, is no UTF-8 text or no TOML (with the line).
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is no file")
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: {size} bytes; a TOML file has at most {MAX_BYTES}")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start + 1} is no UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: no TOML: {error}") from None
    except ValueError as error:  # numbers with thousands of digits
        raise InputError(f"{path}: a value cannot be read: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: lists or tables are nested too deeply; four levels are enough") from None


def name_robot_from(out: Path, data: dict[str, Any], study: Path) -> None:
    """Change the tables of a study file so that they find the robot file from the folder ``out`` too."""
    beside = study.parent / str(data["robot"]["model"])
    if beside.exists():
        data["robot"]["model"] = Path(os.path.relpath(beside, out)).as_posix()


class Problems:
    """Collects what is wrong with one file; nothing is raised before all of it has been looked at."""

    def __init__(self, path: Path) -> None:
        """Start with no problem."""
        self.path = path
        self.lines: list[str] = []

    def add(self, key: str, what: str, *value: object) -> None:
        """Note that the value of ``key`` (if there is one) is wrong, and what would be right."""
        shown = "".join(f" = {_short(item)}" for item in value)
        self.lines.append(f"{key}{shown}: {what}")

    def found(self, heading: str) -> bool:
        """True if a problem of this table has been noted."""
        return any(line.startswith(heading) for line in self.lines)

    def check(self, schema: type[_M], table: object, heading: str) -> _M | None:
        """The table as a record of ``schema``; its problems are noted.

        Returns:
            The record; wrong keys are left out of it, so that the others can be looked at further.
            None where nothing is left to look at.
        """
        try:
            return schema.model_validate(table)
        except ValidationError as error:
            wrong = error.errors(include_url=False)
        for problem in wrong:
            self._note(schema, problem, heading)
        first = {problem["loc"][0] for problem in wrong if problem["loc"]}
        if not isinstance(table, Mapping) or not first & table.keys():
            return None
        try:
            return schema.model_validate({key: value for key, value in table.items() if key not in first})
        except ValidationError:
            return None

    def _note(self, schema: type[BaseModel], problem: ErrorDetails, heading: str) -> None:
        """Note what pydantic found."""
        kind, value, context = problem["type"], problem["input"], problem.get("ctx", {})
        place = [part for part in problem["loc"] if part != "[key]"]
        if set(schema.model_fields) == {"points"} and place[:1] == ["points"]:  # the whole table is a map of points
            place = place[1:]
        if kind == "extra_forbidden":
            what = unknown("key", str(place[-1]), _keys(schema, place[:-1]))
        elif kind == "literal_error":
            what = _choice(value, context["expected"])
        else:
            what = _explain(kind, context, problem["msg"])
        self.add(_key(heading, place), what, *_value(kind, value))

    def finite(self, key: str, value: object) -> None:
        """Note every nan or inf in a raw value that is checked in detail later."""
        inner: Iterable[tuple[str, object]] = ()
        if isinstance(value, Mapping):
            inner = ((f"{key}{' ' if key.endswith(']') else '.'}{name}", item) for name, item in value.items())
        elif isinstance(value, list):
            inner = ((f"{key}, entry {i + 1}", item) for i, item in enumerate(value))
        elif isinstance(value, float) and not math.isfinite(value):
            self.add(key, "a finite number expected", value)
        for name, item in inner:
            self.finite(name, item)

    def settle(self) -> None:
        """End the search.

        Raises:
            InputError: Problems were found; the message holds all of them.
        """
        if len(self.lines) == 1:
            raise InputError(f"{self.path}: {self.lines[0]}")
        if self.lines:
            more = [f"... and {len(self.lines) - _SHOWN} more"] if len(self.lines) > _SHOWN else []
            lines = [f"{self.path}: {len(self.lines)} problems", *self.lines[:_SHOWN], *more]
            raise InputError("\n  ".join(lines))


def nearest(word: str, allowed: Iterable[str]) -> str:
    """`` (did you mean ...?)``, or nothing if no allowed word is near."""
    by_lower = {name.lower(): name for name in allowed}
    found = difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=0.5)
    return f" (did you mean {by_lower[found[0]]!r}?)" if found else ""


def unknown(kind: str, word: str, allowed: Sequence[str]) -> str:
    """What to say about a name that is not among the allowed ones."""
    return f"unknown {kind}{nearest(word, allowed)}; allowed: {', '.join(allowed) or 'none'}"


def _choice(value: object, expected: str) -> str:
    """What to say about a word that is not among the choices."""
    choices = [word.strip("'") for word in expected.replace(" or ", ", ").split(", ")]
    hint = nearest(value, choices) if isinstance(value, str) else ""
    return f"allowed: {', '.join(choices)}{hint}"


def _explain(kind: str, context: Mapping[str, Any], message: str) -> str:
    """What is allowed, from pydantic's kind of error."""
    bounds = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    for key, word in bounds.items():
        if key in context:
            return f"must be {word} {context[key]:.10g}"
    if kind in {"too_short", "too_long"}:
        count = context.get("min_length", context.get("max_length"))
        wanted = "at least one entry" if count == 1 else f"{count} numbers"
        return f"{wanted} expected, {context['actual_length']} given"
    return _TYPES.get(kind, message)


def _keys(schema: type[BaseModel], place: Sequence[int | str]) -> list[str]:
    """Keys of the table of ``schema`` in which ``place`` stands."""
    for part in place:
        if str(part) not in schema.model_fields:  # a name of the user's in a table of tables
            continue
        inner = schema.model_fields[str(part)].annotation
        tables = [kind for kind in getattr(inner, "__args__", (inner,)) if isinstance(kind, type)]
        schema = next(kind for kind in tables if issubclass(kind, BaseModel))
    return list(schema.model_fields)


def _key(heading: str, place: Sequence[int | str]) -> str:
    """A key as the user finds it: ``[[loads]] 2 mass_kg``, ``[noise.tracker] radial_um``, ``[plan] loads, entry 2``."""
    if len(place) > 1 and place[0] in _INNER_TABLES:
        heading, place = f"{heading[:-1]}.{place[0]}]", place[1:]
    if len(place) > 1 and place[0] in _INNER_LISTS and isinstance(place[1], int):
        heading, place = f"[{heading[:-1]}.{place[0]}]] {place[1] + 1}", place[2:]
    names = ".".join(str(part) for part in place if isinstance(part, str))
    entries = "".join(f", entry {part + 1}" for part in place if isinstance(part, int))
    return " ".join(filter(None, [heading, names])) + entries


def _value(kind: str, value: object) -> list[object]:
    """The value to show, if it helps."""
    return [] if kind == "missing" or isinstance(value, dict) else [value]


def _short(value: object) -> str:
    """A value in a message, not longer than a line."""
    try:
        text = repr(value)
    except ValueError:  # numbers with thousands of digits
        return "a very long number"
    return text if len(text) <= 80 else f"{text[:60]} ... ({len(text)} characters)"
