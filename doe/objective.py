"""What a plan is judged by: the criterion of the study on the parameters that can be identified."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from doe.information import inverse_root_of
from doe.observations import target_rows
from doe.subject import Subject
from identify.arrays import Floats
from identify.errors import InputError, NotIdentifiable
from identify.identifiability import Identifiability
from identify.study import Criterion
from identify.units import MM

__all__ = ["Objective", "objective"]

log = logging.getLogger("elastocal")


@dataclass(frozen=True, eq=False)
class Objective:
    """A criterion with its target.

    Attributes:
        criterion: test_pose, A, D, E or G.
        rows: (t, 3, p) rows of the test poses, mm per unit; None without test poses.
        weights: (t,) weights of the test poses, sum 1.
        size: Number p of identifiable parameters.
    """

    criterion: Criterion
    rows: Floats | None
    weights: Floats
    size: int

    def target(self, criterion: Criterion | None = None) -> Floats:
        """What `approximate_design` and `exact_design` call ``target``."""
        criterion = criterion or self.criterion
        if criterion == "G" and self.rows is not None:
            return self.rows
        if criterion == "test_pose" and self.rows is not None:
            return (np.sqrt(self.weights)[:, None, None] * self.rows).reshape(-1, self.size)
        return np.eye(self.size)

    def guarded(self, scale: Floats, share: float) -> Floats:
        """Target with ``share`` of the parameters' own variances, each on the scale of ``scale`` (p,), added."""
        guard = np.sqrt(share) * np.diag(1.0 / scale)
        if self.criterion == "G":
            target = self.target()
            return np.concatenate([target, np.broadcast_to(guard, (len(target), *guard.shape))], axis=1)
        return np.vstack([self.target(), guard])

    def value(self, information: Floats, criterion: Criterion | None = None) -> float:
        """Value of a criterion at an information matrix (p, p); infinite if the matrix is singular for it."""
        criterion = criterion or self.criterion
        root = inverse_root_of(information)
        if root is None:
            return float("inf")
        if criterion == "D":
            return float(np.exp(2 * np.linalg.slogdet(root)[1] / self.size))
        if criterion == "E":
            return float(np.linalg.norm(root, 2) ** 2)
        squares = (self.target(criterion) @ root) ** 2
        return float(squares.sum(axis=(1, 2)).max() if criterion == "G" else squares.sum())


def objective(observer: Subject, known: Identifiability, criterion: Criterion) -> Objective:
    """The objective of a study on the kept parameters.

    Raises:
        InputError: The criterion needs test poses and there are none, or none that depends on a parameter.
        NotIdentifiable: Nothing can be identified, or the criterion needs a direction that the candidates cannot show.
    """
    names, weights = observer.names, observer.weights
    if not len(known.kept):
        reasons = "; ".join(f"{names[d.column]}: {observer.why(d)}" for d in known.dropped[:5])
        raise NotIdentifiable(f"{observer.path}: no parameter can be identified: {reasons}", names)
    rows = None
    try:
        if len(weights) or criterion in {"test_pose", "G"}:
            rows = target_rows(observer, known) / MM
    except NotIdentifiable as error:
        if criterion in {"test_pose", "G"}:
            raise
        log.warning("accuracy at the test poses cannot be told: %s", error)
    if criterion in {"test_pose", "G"} and rows is not None and not rows.any():
        raise InputError(
            f"{observer.path}: [[test_poses]]: nothing that can be identified moves their points, so every plan "
            "would be as good; give them a wrench that loads the joints, or put geometry into the model"
        )
    return Objective(criterion, rows, weights / max(weights.sum(), 1e-300), len(known.kept))
