"""Measurement files with a few rows made wrong: shifted readings, swapped rows, one joint off."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Table:
    """A measurement file as text cells; row i stands in line i + 2."""

    header: list[str]
    rows: list[list[str]]

    @classmethod
    def read(cls, text: str) -> Table:
        """From the text of a file."""
        header, *rows = [line.split(",") for line in text.strip().splitlines()]
        return cls(header, rows)

    def write(self, path: Path) -> Path:
        """To a file."""
        path.write_text("\n".join(",".join(row) for row in [self.header, *self.rows]) + "\n", encoding="utf-8")
        return path

    def numbers(self, names: list[str]) -> np.ndarray:
        """Some columns as numbers, (R, k)."""
        columns = [self.header.index(name) for name in names]
        return np.array([[float(row[c]) for c in columns] for row in self.rows])

    def add(self, row: int, name: str, change: float) -> None:
        """Change one number."""
        column = self.header.index(name)
        self.rows[row][column] = repr(float(self.rows[row][column]) + float(change))

    def swap(self, one: int, other: int, names: list[str]) -> None:
        """Exchange some cells of two rows."""
        for name in names:
            c = self.header.index(name)
            self.rows[one][c], self.rows[other][c] = self.rows[other][c], self.rows[one][c]


POSITION = ["x_mm", "y_mm", "z_mm"]


def spoil(table: Table, rng: np.random.Generator, count: int, joints: int = 6) -> dict[int, str]:
    """Spoil ``count`` rows (at least three), each of another pose, in three ways; returns what was done by row."""
    pose = table.header.index("pose")
    first = {table.rows[row][pose]: row for row in rng.permutation(len(table.rows)).tolist()}
    chosen = rng.permutation(list(first.values()))[:count].tolist()
    done: dict[int, str] = {}
    one, other = chosen[:2]
    table.swap(one, other, POSITION)
    done[one] = done[other] = "swapped"
    for number, row in enumerate(chosen[2:]):
        if number % 2 == 0:
            joint = int(rng.integers(joints))
            table.add(row, f"q{joint + 1}_deg", float(rng.choice([-10.0, 10.0])))
            done[row] = f"joint {joint + 1}"
        else:
            direction = rng.normal(size=3)
            direction *= rng.uniform(5, 50) / np.linalg.norm(direction)
            for name, change in zip(POSITION, direction, strict=True):
                table.add(row, name, change)
            done[row] = "shifted"
    return done
