"""Mistakes in the files: rows that nobody measured like that."""

import csv
import io

import numpy as np

from tests.blind.setting import MARKERS

WAYS = ("swap", "sign", "inch", "rad", "load", "copy", "typo", "outlier")


def spoil(rng, table, way: str) -> str:
    """Change the rows of one pose in place and say which pose it is.

    Args:
        rng: Generator.
        table: The rows of the file.
        way: One of `WAYS`.
    """
    poses = np.unique(table.pose)
    pose, other = rng.choice(poses, 2, replace=False)
    rows = np.flatnonzero(table.pose == pose)
    shot = rows[(table.load[rows] == table.load[rng.choice(rows)]) & (table.repeat[rows] == 1)]
    one = int(rng.choice(rows))
    joint, axis = int(rng.integers(6)), int(rng.integers(3))
    if way == "swap":
        first, second = rng.choice(len(MARKERS), 2, replace=False)
        some = rows if rng.random() < 0.5 else shot
        _exchange(table.xyz, some[table.marker[some] == MARKERS[first]], some[table.marker[some] == MARKERS[second]])
    elif way == "sign":
        table.xyz[one, np.argmax(np.abs(table.xyz[one]))] *= -1
    elif way == "inch":
        table.xyz[rows] /= 25.4
    elif way == "rad":
        table.q[rows] = np.radians(table.q[rows]).round(6)
    elif way == "load":
        low, high = rng.choice(np.unique(table.load), 2, replace=False)
        labels = table.load[rows].copy()
        table.load[rows] = np.where(labels == low, high, np.where(labels == high, low, labels))
    elif way == "copy":
        table.xyz[rows] = table.xyz[table.pose == other]
    elif way == "typo":
        table.q[rows, joint] += float(rng.choice([-10.0, -1.0, 1.0, 10.0]))
    else:
        table.xyz[one, axis] += rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.5), np.log(20.0)))
    return str(pose)


def _exchange(values, first, second):
    values[np.concatenate([first, second])] = values[np.concatenate([second, first])]


def read_plan(text: str, loads: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Visits of a plan file: q (P, 6) rad, load (P, L) indices, names; every visit takes as many readings."""
    rows = list(csv.DictReader(io.StringIO(text)))
    names = list(dict.fromkeys(row["pose"] for row in rows))
    q = np.zeros((len(names), 6))
    load: list[list[int]] = [[] for _ in names]
    for row in rows:
        visit = names.index(row["pose"])
        q[visit] = np.radians([float(row[f"q{j + 1}_deg"]) for j in range(6)])
        load[visit].append(loads.index(row["load"]))
    return q, np.array(load), names
