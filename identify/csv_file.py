"""CSV files by columns: reading with line numbers in every message, writing with fixed decimals."""

from __future__ import annotations

import csv
import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identify.arrays import Floats, Ints
from identify.errors import InputError
from identify.problems import Problems, nearest

__all__ = ["CsvTable", "csv_text", "read_csv", "write_csv"]

_log = logging.getLogger("elastocal")

_ID = re.compile(r"[A-Za-z0-9_.-]+")
_SHOWN = 5  # problems shown of one column
_DECIMALS = 6  # of a mm: 1 nm; of a deg: 17 nrad


@dataclass(frozen=True, eq=False)
class CsvTable:
    """The cells of a CSV file.

    Attributes:
        path: The file.
        cells: Text of the cells by column name, R each.
        lines: (R,) line of each row (the header is line 1).
    """

    path: Path
    cells: Mapping[str, Sequence[str]]
    lines: Ints

    def require(self, names: Sequence[str]) -> None:
        """Stop if columns are missing.

        Raises:
            InputError: Columns are missing; the message names them and what is there instead.
        """
        missing = [name for name in names if name not in self.cells]
        if not missing:
            return
        spare = [name for name in self.cells if name not in names]
        named = ", ".join(f"{name}{nearest(name, spare)}" for name in missing)
        hint = (
            "; the separator must be a comma"
            if len(self.cells) == 1 and re.search(r"[;\t]", next(iter(self.cells)))
            else ""
        )
        raise InputError(
            f"{self.path}: line 1: missing column{'s'[: len(missing) > 1]} {named}{hint}; needed: {', '.join(names)}"
        )

    def group(self, names: Sequence[str]) -> bool:
        """True if all these columns are there, False if none.

        Raises:
            InputError: Only some are there.
        """
        if any(name in self.cells for name in names):
            self.require(names)
            return True
        return False

    def warn_unknown(self, known: Sequence[str]) -> tuple[str, ...]:
        """The columns that are not known, with one warning."""
        ignored = tuple(name for name in self.cells if name not in known)
        if ignored:
            _log.warning("%s: unknown columns ignored: %s", self.path, ", ".join(ignored))
        return ignored

    def numbers(self, names: Sequence[str], problems: Problems) -> Floats:
        """(R, len(names)) finite numbers; what is none is noted and becomes nan."""
        columns = np.empty((len(self.lines), len(names)))
        for i, name in enumerate(names):
            columns[:, i] = self._numbers(name, problems)
        return columns

    def _numbers(self, name: str, problems: Problems) -> Floats:
        """(R,) finite numbers of one column."""
        cells = self.cells[name]
        try:
            values = np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            values = np.array([_number(cell) for cell in cells])
        text = "".join(cells)
        if "_" in text or not text.isascii():  # Python reads 1_000 and digits of other scripts as numbers
            values = np.array([_number(cell) for cell in cells])
        self._note(name, np.flatnonzero(~np.isfinite(values)), _finite, problems)
        return values

    def integers(self, name: str, problems: Problems, *, allowed: Sequence[int] | None = None) -> Ints:
        """(R,) whole numbers, 0 or more (or ``allowed``); others are noted."""
        values = self._numbers(name, problems)
        finite = np.isfinite(values)
        if allowed is None:
            wrong = (values < 0) | (values > 1e9) | (values != np.round(values))
            what = "a whole number from 0 expected"
        else:
            wrong = ~np.isin(values, allowed)
            what = f"allowed: {', '.join(map(str, allowed))}"
        self._note(name, np.flatnonzero(wrong & finite), lambda _: what, problems)
        whole: Ints = np.where(wrong | ~finite, 0, values).astype(np.int64)
        return whole

    def ids(self, name: str, problems: Problems) -> list[str]:
        """R ids without blanks around them; malformed ones are noted."""
        cells = [cell.strip() for cell in self.cells[name]]
        bad = {cell for cell in set(cells) if not _ID.fullmatch(cell)}
        if bad:
            rows = np.flatnonzero([cell in bad for cell in cells])
            self._note(name, rows, lambda _: "an id expected: letters, digits, '_', '.' and '-'", problems)
        return cells

    def choices(self, name: str, allowed: Sequence[str], problems: Problems, *, known: str = "the study has") -> Ints:
        """(R,) index into ``allowed`` of each id; an unknown id is noted once, with its first line.

        Args:
            name: The column.
            allowed: The ids.
            problems: Where to note what is wrong.
            known: What to say before the allowed ids.
        """
        cells = self.ids(name, problems)
        place = {word: i for i, word in enumerate(allowed)}
        for word in dict.fromkeys(cells):
            if word not in place and _ID.fullmatch(word):
                line, count = self.lines[cells.index(word)], cells.count(word)
                what = f"unknown {name} in {count} row{'s'[: count > 1]}{nearest(word, allowed)}"
                problems.add(f"line {line}, {name}", f"{what}; {known}: {', '.join(allowed)}", word)
        return np.fromiter((place.get(cell, 0) for cell in cells), np.int64, len(cells))

    def _note(self, name: str, rows: Ints, what: Callable[[str], str], problems: Problems) -> None:
        """Note the first rows of those that are wrong."""
        for row in rows[:_SHOWN]:
            cell = self.cells[name][row]
            problems.add(f"line {self.lines[row]}, {name}", what(cell), cell)
        if len(rows) > _SHOWN:
            problems.add(name, f"{len(rows) - _SHOWN} more rows of the same kind")


def read_csv(path: str | Path) -> CsvTable:
    """Read a CSV file: UTF-8 (a byte order mark is allowed), comma, one header row; empty rows are skipped.

    Raises:
        InputError: The file cannot be read, is no CSV, or its rows have different lengths.
    """
    path = Path(path)
    rows: list[list[str]] = []
    lines: list[int] = []
    last = 0
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is no file")
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            for row in reader:
                if any(row):
                    rows.append(row)
                    lines.append(last + 1)
                last = reader.line_num
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: near line {last + 1}: no UTF-8 text") from None
    except csv.Error as error:
        raise InputError(f"{path}: line {last + 1}: no CSV: {error}") from None
    if len(rows) < 2:
        raise InputError(f"{path}: {'no rows below the header' if rows else 'the file is empty'}")
    return _by_column(path, rows, lines)


def _by_column(path: Path, rows: list[list[str]], lines: list[int]) -> CsvTable:
    """Turn rows into columns.

    Raises:
        InputError: A column name stands twice, or a row is too long or too short.
    """
    header = [name.strip() for name in rows[0]]
    twice = sorted({name for name in header if name and header.count(name) > 1})
    if twice:
        raise InputError(f"{path}: line {lines[0]}: column {', '.join(twice)} stands twice")
    wrong = [i for i, row in enumerate(rows) if len(row) != len(header)]
    if wrong:
        i = wrong[0]
        more = f" ({len(wrong)} such rows)" if len(wrong) > 1 else ""
        raise InputError(f"{path}: line {lines[i]}: {len(rows[i])} cells, the header has {len(header)}{more}")
    columns = {}
    for i, (name, cells) in enumerate(zip(header, zip(*rows[1:], strict=True), strict=True)):
        if name or any(cells):  # spreadsheets leave empty columns at the end
            columns[name or f"column {i + 1}"] = cells
    return CsvTable(path, columns, np.array(lines[1:], dtype=np.int64))


def _number(cell: str) -> float:
    """The number of a cell, or nan."""
    try:
        return float(cell) if cell.isascii() and "_" not in cell else np.nan
    except ValueError:
        return np.nan


def _finite(cell: str) -> str:
    """What to say about a cell that holds no finite number."""
    if not cell.strip():
        return "is empty; leave the whole row out where a reading is missing"
    return "a finite number with '.' as decimal sign expected"


def csv_text(header: Sequence[str], columns: Sequence[Sequence[object] | np.ndarray]) -> str:
    """A table as CSV text: whole numbers and texts as they are, other numbers with six decimals; LF.

    Args:
        header: Names of the columns.
        columns: One sequence a column, all of the same length.

    Raises:
        InputError: A number is not finite.
    """
    cells, marks = [], []
    for name, column in zip(header, columns, strict=True):
        array = np.asarray(column)
        if array.dtype.kind == "f":
            if not np.isfinite(array).all():
                raise InputError(f"column {name}: nan or inf cannot be written")
            array = np.round(array, _DECIMALS) + 0.0  # no minus zero
            marks.append(f"%.{_DECIMALS}f")
        else:
            marks.append("%s")
        cells.append(array.tolist())
    line = ",".join(marks)
    return "\n".join([",".join(header), *(line % row for row in zip(*cells, strict=True))]) + "\n"


def write_csv(path: Path, header: Sequence[str], columns: Sequence[Sequence[object] | np.ndarray]) -> None:
    """Write `csv_text` to a file; results of commands go through `identify.results` instead."""
    path.write_text(csv_text(header, columns), encoding="utf-8", newline="\n")
