"""Continuous refinement: move the joint angles of all poses of a plan off the candidate grid.

Minimises the logarithm of the criterion over the joint values of all visits at once, with derivatives from
`doe.chain` and the interior-point solver IPOPT (Wächter and Biegler 2006), under bounds and a floor:

    minimise  log trace(C M(q)^-1 C'),    M(q) = sum_i A(q_i)'A(q_i)

in parameters that are whitened by the plan it starts from, so that M starts at I. The result counts only by
the exact blocks of the observer: a plan is replaced only by one that is better by them and keeps all bounds.
It is a local search and proves nothing. The largest value of criterion G has corners, so it is approached
from above by ``log(sum_t value_t^s)/s`` with growing s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from doe.chain import block_function, missing_columns
from doe.criteria import Criterion, Mean, MinimumEigenvalue, Volume, Worst
from doe.floor import floor_points
from doe.observations import Observer
from doe.symbolic_arm import heights_function, load_table
from identify.arrays import Floats, Ints, frozen
from identify.errors import InputError
from identify.threads import one_thread

__all__ = ["Others", "Refinement", "can_refine", "refine"]

_LONG = 40  # visits; in longer plans the same ones stay together, and so many different ones get fewer iterations
_FEWEST = 60  # of these iterations
_ASIDE = 0.002  # rad: the solver starts this far from the plan, so that it leaves a saddle point
_APART = 0.02  # rad: visits of one pose start this far from each other
_CLEARANCE = 1e-6  # m above the floor that the solver keeps, so that its rounding does not break it
_SHARPNESS = (30.0, 300.0)  # of the smooth maximum of criterion G, one run each; log(t)/s is what it is off by
_CONDITION = 1e-9  # unit columns: below this a starting plan counts as singular
_RADII = (0.5, 0.5, 0.5, 0.25, 0.0)  # how far refused poses may move in the next round, in steps that were refused
_HALVINGS = 6  # of such a step
_IPOPT: dict[str, Any] = {
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.limited_memory_max_history": 20,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.bound_push": 1e-4,
    "ipopt.bound_frac": 1e-4,
    "ipopt.tol": 1e-6,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_obj_change_tol": 1e-7,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "print_time": False,
    "show_eval_warnings": False,
}


@dataclass(frozen=True, eq=False)
class Others:
    """Experiments of the same plan that stay where they are, of another arm.

    Attributes:
        rows: (K, P) their whitened rows on all P kept parameters of the plan.
        place: (p,) where the kept parameters of the moved experiments stand among these.
    """

    rows: Floats
    place: Ints

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        object.__setattr__(self, "rows", frozen(self.rows))
        object.__setattr__(self, "place", frozen(self.place, np.int64))

    def spread(self, rows: Floats) -> Floats:
        """Rows (..., p) of moved experiments on all parameters of the plan, (..., P)."""
        wide = np.zeros((*rows.shape[:-1], self.rows.shape[1]))
        wide[..., self.place] = rows
        return wide


@dataclass(frozen=True, eq=False)
class Refinement:
    """What the refinement made of a plan.

    Attributes:
        q: (n, dof) joint values, rad or m: the refined ones, or the given ones if nothing was gained.
        value_before: The criterion (with the guard) of the given plan.
        value_after: The same of ``q``; never larger.
        iterations: Iterations of the solver.
        status: The solver's last word, or ``not run``.
        reason: Why nothing was gained, or None.
    """

    q: Floats
    value_before: float
    value_after: float
    iterations: int
    status: str
    reason: str | None = None

    def __post_init__(self) -> None:
        """Make the joint values read-only."""
        object.__setattr__(self, "q", frozen(self.q))

    @property
    def gain(self) -> float:
        """Share of the criterion that was gained, 0 to 1."""
        return 1.0 - self.value_after / self.value_before


def can_refine(observer: Observer, criterion: str = "test_pose") -> str | None:
    """Why symbolic derivatives cannot move plans of this observer under this criterion, or None if they can.

    Plans of one arm are then moved by differences of their blocks, see `doe.polish`.
    """
    missing = missing_columns(observer)
    if missing:
        return f"effect {', '.join(missing)} has no symbolic columns"
    if criterion == "E":
        return "criterion E has no derivative where the smallest eigenvalue repeats"
    return None


def refine(
    observer: Observer,
    q: Floats,
    visit_loads: Ints,
    kept: Ints,
    target: Floats | None,
    *,
    criterion: str = "test_pose",
    guard: Floats | None = None,
    lower: Floats,
    upper: Floats,
    floor: float | None = None,
    max_std: Floats | None = None,
    allowed: Callable[[Floats], np.ndarray] | None = None,
    others: Others | None = None,
    max_iterations: int = 300,
) -> Refinement:
    """Improve a plan by moving its joint values; one row is one visit, a pose visited twice stands twice.

    In plans of more than 40 visits, those of one pose and load stay together: they have little to gain from parting,
    and the work grows with the different visits alone.

    Args:
        observer: What turns poses into blocks.
        q: (n, dof) joint values of the plan, rad or m.
        visit_loads: (n, L) load of each shot; they stay as they are.
        kept: (p,) columns of the observer's model that the plan shows.
        target: (r, p) rows C on the kept columns for test_pose, (t, r, p) for G, (r, p) or None (the parameters
            themselves) for A; not used by D.
        criterion: test_pose, A, D or G.
        guard: (g, p) rows whose variance is added to the criterion (to every test pose for G; not for D).
        lower: (dof,) lowest joint values; ``-inf`` for none.
        upper: (dof,) highest joint values; ``inf`` for none.
        floor: Lowest world height of joints, flange, markers and loads, from the base origin, m.
        max_std: (p,) standard deviation that each kept parameter must not exceed, in its unit; ``inf`` for no limit.
            A plan that exceeds it to begin with must not get worse in this.
        allowed: ``(n, dof) -> (n,)`` bool for what has no derivative (self-collision): poses that it refuses
            are moved back until it does not, and may go on from there less far in the next round.
        others: What else belongs to the plan; then p above counts all parameters of the plan (but in ``kept``).
        max_iterations: Limit of the solver in each round.

    Returns:
        The better plan, or the given one with the reason.

    Raises:
        InputError: Shapes do not fit, or a guard is given for D.
    """
    q = np.array(q, dtype=np.float64)
    if len(q) > _LONG and q.ndim == 2 and visit_loads.shape[:1] == q.shape[:1]:
        first, place = _distinct(q, visit_loads)
    else:
        first = place = np.arange(len(q))
    problem = _problem(observer, q[first], visit_loads[first], kept, lower, upper, floor, others, np.bincount(place))
    found = _refined(
        _with_goal(problem, criterion, target, guard, max_std),
        q[first],
        can_refine(observer, criterion),
        None if allowed is None else lambda moved: np.asarray(allowed(moved[place]))[first],
        min(max_iterations, max(_FEWEST, max_iterations * _LONG // len(first))),
    )
    return replace(found, q=found.q[place])


def _distinct(q: Floats, visit_loads: Ints) -> tuple[Ints, Ints]:
    """Where each different visit of a plan stands first, and (n,) which of these each visit is."""
    _, first, place = np.unique(np.hstack([q, visit_loads]), axis=0, return_index=True, return_inverse=True)
    return first, place.ravel()


def _refined(
    problem: _Problem,
    q: Floats,
    reason: str | None,
    allowed: Callable[[Floats], np.ndarray] | None,
    max_iterations: int,
) -> Refinement:
    """The better plan of different visits (n, dof), or the given one with the reason."""
    before = problem.value(q)
    if reason is None and not np.isfinite(before):
        reason = "the plan to start from does not show all kept parameters"
    if reason is not None:
        return Refinement(q, before, before, 0, "not run", reason)
    with one_thread():
        found, iterations, status = _solve(problem, q, allowed, max_iterations)
    for share in 0.5 ** np.arange(6):  # the last iterate of a limited run may break a bound or be worse
        moved = np.clip(q + share * (found - q), problem.lower, problem.upper)
        after = problem.value(moved)
        if after < before and problem.keeps(moved, q) and (allowed is None or np.all(allowed(moved))):
            return Refinement(moved, before, after, iterations, status)
    reason = f"no better plan that keeps all limits was found near this one (solver: {status})"
    return Refinement(q, before, before, iterations, status, reason)


@dataclass(frozen=True, eq=False)
class _Problem:
    """One refinement.

    Attributes:
        observer: What turns poses into blocks.
        visit_loads: (n, L).
        times: (n,) how often each visit is made.
        kept: Kept columns of the observer's model.
        others: What else belongs to the plan, or None.
        basis: (p, p) coordinates in which the given plan has the information I.
        lower: (n, dof) lowest joint values.
        upper: (n, dof) highest joint values.
        floor: Lowest world height, m; ``-inf`` for none.
        criterion: The criterion in these coordinates.
        spread: The largest variance of a parameter in squares of its limit, in these coordinates; None for no limit.
    """

    observer: Observer
    visit_loads: Ints
    times: Ints
    kept: Ints
    others: Others | None
    basis: Floats
    lower: Floats
    upper: Floats
    floor: float
    criterion: Criterion
    spread: Worst | None = None

    @property
    def loads(self) -> Floats:
        """(15, L n) numbers of the load of every shot, visit by visit."""
        study = self.observer.study
        table: Floats = load_table(study.robot, study.loads)[self.visit_loads.ravel()].T
        return table

    def value(self, q: Floats, criterion: Criterion | None = None) -> float:
        """The criterion by the exact blocks; infinite where the information is singular."""
        try:
            rows = _rows(self.observer, q, self.visit_loads, self.times, self.kept, self.others) @ self.basis
            return (criterion or self.criterion).value(rows.T @ rows)
        except np.linalg.LinAlgError:
            return float("inf")

    def heights(self, q: Any) -> Any:
        """World heights (h, n) of what must stay above the floor, m, for ``q`` (dof, n), symbols or numbers."""
        study = self.observer.study
        found = [floor_points(study, loads) for loads in self.visit_loads]
        points = [np.unique(np.column_stack([own.local, own.below]), axis=0) for own in found]
        most = max(len(own) for own in points)
        padded = np.array([np.vstack([own, np.repeat(own[:1], most - len(own), axis=0)]) for own in points])
        joints = floor_points(study).joints
        function = heights_function(study.robot, joints, most)
        below = np.hstack([np.zeros((len(points), len(joints))), padded[:, :, 3]])
        return function.map(len(points))(q, padded[:, :, :3].reshape(-1, 3).T) - below.T

    def keeps(self, moved: Floats, q: Floats) -> bool:
        """True if nothing is below the floor and no parameter is beyond its limit and worse than in the plan ``q``."""
        if self.floor > -np.inf and (np.asarray(self.heights(ca.DM(moved.T))) < self.floor).any():
            return False
        return self.spread is None or self.value(moved, self.spread) <= max(1.0, self.value(q, self.spread))


def _rows(observer: Observer, q: Floats, visit_loads: Ints, times: Ints, kept: Ints, others: Others | None) -> Floats:
    """Stacked whitened rows of the whole plan on all its kept columns, (K, p)."""
    blocks = observer.blocks(q, visit_loads)[:, :, kept] * np.sqrt(times)[:, None, None]
    rows: Floats = blocks.reshape(-1, len(kept))
    return rows if others is None else np.vstack([others.spread(rows), others.rows])


def _problem(
    observer: Observer,
    q: Floats,
    visit_loads: Ints,
    kept: Ints,
    lower: Floats,
    upper: Floats,
    floor: float | None,
    others: Others | None,
    times: Ints,
) -> _Problem:
    """Check the plan and choose coordinates; the criterion is A until another is set."""
    dof = observer.study.robot.n
    if q.ndim != 2 or q.shape[1] != dof or visit_loads.shape[:1] != q.shape[:1] or len(q) == 0:
        raise InputError(f"q has shape {q.shape} and visit_loads {visit_loads.shape}, needed: (n, {dof}) and (n, L)")
    basis = _whitening_basis(_rows(observer, q, visit_loads, times, kept, others))
    lowest, highest = (np.broadcast_to(np.asarray(bound, dtype=np.float64), q.shape) for bound in (lower, upper))
    lowest_point = -np.inf if floor is None else floor
    return _Problem(observer, visit_loads, times, kept, others, basis, lowest, highest, lowest_point, Mean(basis))


def _with_goal(
    problem: _Problem, name: str, target: Floats | None, guard: Floats | None, max_std: Floats | None
) -> _Problem:
    """Set the criterion and the limits of the standard deviations."""
    p = len(problem.basis)
    spread = None
    if max_std is not None and np.isfinite(max_std).any():
        limited = np.flatnonzero(np.isfinite(max_std))
        unit = np.eye(p)[limited] / np.asarray(max_std)[limited, None]
        spread = Worst(unit[:, None] @ problem.basis)
    rows = np.zeros((0, p)) if guard is None else guard
    return replace(problem, criterion=_criterion(name, problem.basis, target, rows), spread=spread)


def _whitening_basis(rows: Floats) -> Floats:
    """``R^-1`` of ``rows = Q R``, (p, p); with unit columns only where the rows are singular."""
    norms = np.linalg.norm(rows, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    triangle = np.linalg.qr(rows / norms, mode="r")
    square = len(triangle) == len(norms)
    if not square or np.abs(np.diag(triangle)).min(initial=1.0) < _CONDITION:
        return np.diag(1.0 / norms)
    basis: Floats = np.linalg.inv(triangle) / norms[:, None]
    return basis


def _criterion(name: str, basis: Floats, target: Floats | None, guard: Floats) -> Criterion:
    """The criterion in the coordinates ``basis``."""
    p = len(basis)
    if name == "D":
        if len(guard):
            raise InputError("a guard is given for criterion D, which sees every parameter already; leave it out")
        return Volume(basis)
    if name == "E":
        return MinimumEigenvalue(basis)
    if name == "A" and target is None:
        target = np.eye(p)
    dimensions = {"test_pose": 2, "A": 2, "G": 3}.get(name)
    if dimensions is None:
        raise InputError(f"criterion is {name!r}, allowed: test_pose, A, D, E, G")
    if target is None or target.ndim != dimensions or target.shape[-1] != p:
        shape = None if target is None else target.shape
        raise InputError(f"target of {name} has shape {shape}, needed: {dimensions} axes, the last of {p}")
    if name == "G":
        return Worst(np.stack([np.vstack([rows, guard]) for rows in target]) @ basis)
    return Mean(np.vstack([target, guard]) @ basis)


# --- the nonlinear programme -----------------------------------------------------------------------------------------


def _solve(
    problem: _Problem, q: Floats, allowed: Callable[[Floats], np.ndarray] | None, max_iterations: int
) -> tuple[Floats, int, str]:
    """Best joint values (n, dof) of all rounds, the iterations and the solver's last word."""
    solver = _solver(problem, max_iterations)
    sharpness = _SHARPNESS if isinstance(problem.criterion, Worst) else (1.0,)
    lower, upper, found = problem.lower, problem.upper, _apart(problem, q)
    iterations, best, least = 0, q, np.inf
    for radius in _RADII:
        for sharp in sharpness:
            found, steps, status = _run(solver, problem, sharp, found, lower, upper)
            iterations += steps
        kept = found if allowed is None else _pulled_back(found, q, allowed)
        refused = (kept != found).any(axis=1)
        if (value := problem.value(kept)) < least:
            best, least = kept, value
        if not refused.any():
            break
        reach = np.where(refused[:, None], radius * np.abs(found - kept), np.inf)
        lower, upper = (np.clip(kept + side * reach, problem.lower, problem.upper) for side in (-1.0, 1.0))
        found = kept
    return best, iterations, status


def _pulled_back(found: Floats, q: Floats, allowed: Callable[[Floats], np.ndarray]) -> Floats:
    """Poses (n, dof) that are refused, moved back towards the ones they come from until they are allowed."""
    kept = np.array(found)
    share = np.ones(len(q))
    for _ in range(_HALVINGS):
        refused = ~np.asarray(allowed(kept))
        if not refused.any():
            return kept
        share[refused] *= 0.5
        kept[refused] = (q + share[:, None] * (found - q))[refused]
    refused = ~np.asarray(allowed(kept))
    kept[refused] = q[refused]
    return kept


def _joint_scale(problem: _Problem) -> Floats:
    """Size of a usual step of each joint, (dof,): 1 rad, or a third of the stroke of a sliding joint (or 1 m)."""
    stroke = (problem.upper - problem.lower)[0]
    slides = problem.observer.study.robot.prismatic & np.isfinite(stroke) & (stroke > 0.0)
    return np.where(slides, np.where(slides, stroke, 1.0) / 3.0, 1.0)


def _apart(problem: _Problem, q: Floats) -> Floats:
    """The plan a little off its stationary points, and visits of the same pose off each other.

    Symmetric poses may be saddle points, and twins would have the same derivatives for ever.
    """
    kinds = np.unique(np.hstack([q, problem.visit_loads]), axis=0, return_inverse=True)[1].ravel()
    twin = np.array([np.any(kinds[:row] == kind) for row, kind in enumerate(kinds)])
    size = np.where(twin, _APART, _ASIDE)[:, None] * _joint_scale(problem)
    return np.clip(q + np.random.default_rng(0).uniform(-size, size), problem.lower, problem.upper)


def _solver(problem: _Problem, max_iterations: int) -> Any:
    """IPOPT for all visits at once, in scaled joint values; its parameter is the sharpness of the maximum."""
    count, dof = problem.lower.shape
    shots, p = problem.visit_loads.shape[1], len(problem.basis)
    x, sharpness = ca.MX.sym("x", dof, count), ca.MX.sym("sharpness")
    q = ca.repmat(_joint_scale(problem), 1, count) * x
    block = block_function(problem.observer, shots, problem.kept).map(count)
    own, known = problem.basis, np.zeros((p, p))
    if problem.others is not None:
        own, fixed = problem.basis[problem.others.place], problem.others.rows @ problem.basis
        known = fixed.T @ fixed
    rows = ca.DM(own.T) @ block(q, problem.loads)
    often = np.repeat(np.sqrt(problem.times), rows.shape[1] // count)
    rows = rows * ca.repmat(ca.DM(often).T, p, 1)
    information = rows @ rows.T + ca.DM(known)
    objective = _goal(problem.criterion, p)(information, sharpness)
    limits = []  # all of them at least 0
    if problem.spread is not None:
        limits.append(-_goal(problem.spread, p)(information, _SHARPNESS[0]))
    if problem.floor > -np.inf:
        limits.append(ca.vec(problem.heights(q)) - (problem.floor + _CLEARANCE))
    programme = {"x": ca.vec(x), "f": objective, "g": ca.vertcat(*limits), "p": sharpness}
    return ca.nlpsol("refine", "ipopt", programme, _IPOPT | {"ipopt.max_iter": max_iterations})


def _goal(criterion: Criterion, p: int) -> Any:
    """Logarithm of the criterion, the largest value smoothed from above: ``(M (p, p), sharpness) -> (1, 1)``."""
    information, sharpness = ca.SX.sym("M", p, p), ca.SX.sym("sharpness")
    root = ca.chol(information)
    if isinstance(criterion, Volume):
        goal = -2.0 / p * ca.sum1(ca.log(ca.diag(root)))
    elif isinstance(criterion, Mean):
        goal = ca.log(ca.sumsqr(ca.solve(root.T, ca.SX(criterion.target.T))))
    elif isinstance(criterion, Worst):
        values = [ca.sumsqr(ca.solve(root.T, ca.SX(rows.T))) for rows in criterion.target]
        goal = ca.logsumexp(sharpness * ca.log(ca.vertcat(*values))) / sharpness
    else:
        raise TypeError(f"no symbolic form of {type(criterion).__name__}")
    return ca.Function("goal", [information, sharpness], [goal])


def _run(
    solver: Any, problem: _Problem, sharpness: float, q: Floats, lower: Floats, upper: Floats
) -> tuple[Floats, int, str]:
    """One run of the solver from ``q`` (n, dof)."""
    scale = _joint_scale(problem)
    start, lowest, highest = ((values / scale).ravel() for values in (q, lower, upper))
    result = solver(x0=start, lbx=lowest, ubx=highest, lbg=0.0, ubg=np.inf, p=sharpness)
    found = np.asarray(result["x"]).reshape(q.shape) * scale
    found = np.where(np.isfinite(found), found, q)
    stats = solver.stats()
    return found, int(stats["iter_count"]), str(stats["return_status"])
