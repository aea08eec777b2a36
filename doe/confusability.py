"""Before measuring: which causes a plan would show, and which it could not tell apart.

Every cause that the model does not hold is taken at its typical size. What the model, frame and markers cannot
imitate of it is its detectability ``|(I - P_X) x|^2``, the non-centrality of its score test. What a rival cannot
imitate either, ``|(I - P_[X,G]) x|^2``, tells whether the two could be confused; so does the smallest angle between
the subspaces that both span beyond the model (Björck and Golub 1973).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identify.arrays import Floats, Ints
from identify.diagnosis.evidence import Evidence, evidence
from identify.diagnosis.library import TOGETHER, Hypothesis, hypotheses, tried
from identify.diagnosis.search import fitted
from identify.diagnosis.verdict import known_reference
from identify.experiment import Experiment, Measurements
from identify.model import model_of
from identify.response import respond
from identify.study import Study
from identify.threads import one_thread

__all__ = ["SHOWN", "Confusable", "confusability"]

SHOWN = 35.0  # energy at which a cause, or a pair of causes, is safely seen
_GUESS = 0.1  # of the largest plausible size, where no typical one is known
# Compliances of an arm for 200 kg; those of an arm for 10 kg are some 20 times larger.
_PAYLOAD = 200.0  # kg
_SOFT = {"joint_compliance": 1.0}  # urad/Nm
_TUBE = {"urad/Nm": 0.1, "urad/N": 0.03, "um/N": 0.01}  # of a link
_ALIKE = 1e-9  # relative eigenvalue below which a direction does not count


@dataclass(frozen=True, eq=False)
class Confusable:
    """A cause as a plan would show it.

    Attributes:
        hypothesis: The cause at its place.
        typical: (b,) sizes of its parameters that are taken as typical, in their units.
        energy: Detectability at these sizes, with random signs.
        detectable: (b,) size of each parameter alone at which its energy is `SHOWN`; infinite where none is seen.
        rival: The cause that imitates most of it; None if there is no other.
        beside_rival: What is left of the energy beside the rival.
        cosine: Of the smallest angle between both subspaces beyond the model.
    """

    hypothesis: Hypothesis
    typical: Floats
    energy: float
    detectable: Floats
    rival: str | None
    beside_rival: float
    cosine: float


def confusability(study: Study, experiment: Experiment) -> tuple[str, tuple[Confusable, ...]]:
    """Judge a plan by every cause that the model of a study does not hold.

    Args:
        study: The study.
        experiment: The plan.

    Returns:
        The reference that a diagnosis would use, and the causes, those that are hardest to tell from a rival first.

    Raises:
        NoConvergence: The model cannot be fitted to its own readings.
    """
    with one_thread():
        study = _compliant(study)
        reference = known_reference(study, experiment)
        position = respond(model_of(study), experiment, model_of(study).nominal, derivative=False).position
        perfect = Measurements(experiment, position, np.arange(2, len(position) + 2), source="the plan")
        found = fitted(study, perfect, differences=reference == "differences")
        asked = [h for h in hypotheses(study, found.model, found) if not (h.where is None and h.name in TOGETHER)]
        every = {h: _typical(h, _softness(study)) for h in asked}
        sizes = {h: size for h, size in every.items() if np.isfinite(size).all()}
        seen = evidence(found, tried(found, tuple(sizes)))
        return reference, tuple(sorted(_judged(seen, sizes), key=lambda c: (c.beside_rival, c.energy)))


def _compliant(study: Study) -> Study:
    """The study with usual joint compliances where it states none: what acts through them would not show without."""
    usual = {
        parameter.name: _SOFT["joint_compliance"] * _softness(study)
        for effect in model_of(study).effects
        if effect.name == "joint_compliance"
        for parameter in effect.parameters
        if parameter.unit == "urad/Nm"
    }
    return replace(study, nominal={**usual, **study.nominal})


def _softness(study: Study) -> float:
    """Usual compliances of the arm, those of an arm for 200 kg being 1."""
    payload = study.robot.payload
    return _PAYLOAD / payload if payload > 0 else 1.0


def _typical(hypothesis: Hypothesis, softness: float) -> Floats:
    """(b,) sizes to expect; infinite where nothing is known."""
    own = [hypothesis.effect.parameters[index] for index in hypothesis.own]
    sizes = np.array([_GUESS * p.plausible if np.isnan(p.typical) else p.typical for p in own])
    usual = np.array([_SOFT.get(hypothesis.name, _TUBE.get(p.unit, np.inf)) for p in own]) * softness
    return np.where(np.isinf(sizes), usual, sizes)


def _judged(seen: Evidence, sizes: dict[Hypothesis, Floats]) -> list[Confusable]:
    """Each cause at the options that show it best, with its closest rival."""
    asked, typical = tuple(sizes), tuple(sizes.values())
    size = np.concatenate(typical) if typical else np.zeros(0)
    energies = np.array([float(((size * seen.scale)[where] ** 2).sum()) for where in seen.where])
    kept = _best_of_each(asked, energies)
    left = _beside(seen, kept, size)
    judged = []
    for number, block in enumerate(kept):
        where = seen.where[block]
        rival = int(np.argmin(left[number])) if len(kept) > 1 and energies[block] > 0 else number
        judged.append(
            Confusable(
                asked[block],
                typical[block],
                float(energies[block]),
                np.sqrt(SHOWN) / np.where(seen.scale[where] > 0, seen.scale[where], np.nan),
                asked[kept[rival]].entry if rival != number else None,
                min(float(left[number, rival]), float(energies[block])),
                _cosine(seen, int(block), int(kept[rival])) if rival != number else 0.0,
            )
        )
    return judged


def _best_of_each(asked: tuple[Hypothesis, ...], energies: Floats) -> Ints:
    """One block for each cause and place."""
    best: dict[str, int] = {}
    for block in np.argsort(-energies, kind="stable"):
        best.setdefault(asked[block].entry, int(block))
    return np.sort(np.array(list(best.values()), dtype=np.int64))


def _beside(seen: Evidence, kept: Ints, size: Floats) -> Floats:
    """(m, m) energy of each block at typical sizes that another one cannot imitate; infinite on the diagonal."""
    turns = [_orthonormal(seen, int(block)) for block in kept]
    weights = [size[seen.where[block]] * seen.scale[seen.where[block]] for block in kept]
    columns = np.concatenate([np.arange(seen.where[b].start, seen.where[b].stop) for b in kept]) if len(kept) else kept
    ends = np.cumsum([0, *(turn.shape[1] for turn in turns)])
    gram = seen.gram[np.ix_(columns, columns)] * np.concatenate(weights or [np.zeros(0)])
    parts = np.cumsum([0, *map(len, weights)])
    imitated = np.zeros((int(ends[-1]), len(columns)))
    for turn, begin, first in zip(turns, ends, parts, strict=False):
        imitated[begin : begin + turn.shape[1]] = turn.T @ gram[first : first + len(turn)]
    share = _grouped(_grouped(imitated**2, ends).T, parts)
    whole = np.array([float((weight**2).sum()) for weight in weights])
    left = np.maximum(whole[:, None] - share, 0.0)
    np.fill_diagonal(left, np.inf)
    return left


def _grouped(rows: Floats, ends: Ints) -> Floats:
    """Sums of rows over groups that end at ``ends``; empty groups give zero."""
    total = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)])
    summed: Floats = total[ends[1:]] - total[ends[:-1]]
    return summed


def _orthonormal(seen: Evidence, block: int) -> Floats:
    """(b, d) combinations of a block's columns that are orthonormal beyond the model."""
    where = seen.where[block]
    values, vectors = np.linalg.eigh(seen.gram[where, where])
    shown = values > _ALIKE * max(values.max(initial=0.0), 1e-300)
    turn: Floats = vectors[:, shown] / np.sqrt(values[shown])
    return turn


def _cosine(seen: Evidence, block: int, other: int) -> float:
    """Cosine of the smallest angle between two blocks beyond the model; 0 if one is not seen."""
    one, two = _orthonormal(seen, block), _orthonormal(seen, other)
    product = one.T @ seen.gram[seen.where[block], seen.where[other]] @ two
    return min(float(np.linalg.norm(product, 2)), 1.0) if product.size else 0.0
