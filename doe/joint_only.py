"""What a plan made for joint compliances alone is worth for a more complete model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from doe.exact import exact_design
from doe.information import information_of
from doe.objective import objective
from doe.observations import identifiable, keep_columns, observer
from doe.plan import Plan
from identify.errors import NotIdentifiable

__all__ = ["JointOnly", "joint_only"]

_JOINT = "joint_compliance"


@dataclass(frozen=True)
class JointOnly:
    """A plan of the same size on the same candidates, made for joint compliances alone.

    Attributes:
        value: The criterion of the complete model at that plan; infinite if it does not show all parameters.
        times: ``value`` over the value of the complete model's own plan on the candidates.
        rank: Parameters of the complete model that it shows.
    """

    value: float
    times: float
    rank: int


def joint_only(made: Plan, *, seed: int = 0) -> JointOnly | None:
    """Compare a plan with one for joint compliances alone.

    Args:
        made: The plan for the complete model.
        seed: Seed of the search.

    Returns:
        The comparison; None where the model is not more than joint compliances, or these cannot be planned for.
    """
    pool = made.pool
    study = pool.observer.study
    if pool.prior is not None:
        return None  # what was measured belongs to the complete model
    if all(name.partition("@")[0] in {_JOINT, "geometry"} for name in study.effects):
        return None
    nominal = {name: value for name, value in study.nominal.items() if name.startswith(f"{_JOINT}.")}
    bare = replace(study, effects=(_JOINT,), nominal=nominal, reference=pool.observer.reference)
    simple = observer(bare, own_visits=pool.observer.own_visits)
    try:
        blocks = simple.blocks(pool.candidates.visit_q, pool.candidates.visit_loads)
        known = identifiable(blocks, parameters=simple.parameters)
        aim = objective(simple, known, study.plan.criterion)
        found = exact_design(
            keep_columns(blocks, known.kept),
            aim.target(),
            len(made.q),
            criterion=aim.criterion,
            repeats=study.plan.repeats,
            effort="low",
            seed=seed,
        )
    except NotIdentifiable:
        return None  # joint compliances alone cannot answer the question that the complete model is asked
    own = pool.blocks[np.repeat(np.arange(len(found.counts)), found.counts)]
    value = pool.objective.value(information_of(own))
    return JointOnly(value, value / made.grid.value, identifiable(own).rank)
