# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% tags=["parameters"]
STUDY = "configs/studies/kr270_cell.toml"  # floor, wall, cabinet, tracker, three weights, times
OTHERS = ["configs/studies/kr270.toml", "configs/studies/kr270_complete.toml"]  # one weight, no tracker
TRUTH = "configs/truths/kr270.toml"  # the springs that the simulated robot really has
SEED = 0
CANDIDATES = 2000  # visits that the cell allows; the study itself asks for more
COUNTS = [5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60, 65, 80, 100]  # visits of a plan
DESIGNED, RANDOM = 15, 60
RANDOM_PLANS = 50  # of each size
REPETITIONS = 16  # simulated campaigns of either kind

# %% [markdown]
# # Random 60 against designed 15
#
# A cell with a KUKA KR 270: a floor, a wall, a cabinet, a laser tracker that must see three reflectors, and three
# weights on a rope. Two crews measure the springs of its joints.
#
# * One takes 60 random visits: poses that the cell allows, each with one of the weights. No joint box, no bad luck:
#   every visit is clear of obstacles, within the payload and in the tracker's sight.
# * The other takes 15 visits that were designed for the poses where accuracy counts.
#
# Who knows the robot better, and who is home earlier?

# %%
# %matplotlib inline
from dataclasses import replace
from pathlib import Path

import numpy as np

from doe import exact_design, view
from doe.accuracy import accuracy
from doe.choice import Choice
from doe.guard import Guard
from doe.information import covariance_of
from doe.moves import free_moves
from doe.plan import plan, scheduled_choice
from doe.pool import build_pool
from doe.schedule import time_as_given
from identify import identify, load_study
from identify.experiment import full_experiment
from identify.model import model_of
from identify.simulate import default_placement, simulate
from identify.truth import load_truth
from identify.units import HOUR

root = next(folder for folder in [Path.cwd(), *Path.cwd().parents] if (folder / STUDY).is_file())


def asked(file):
    """A study that plans the designed number of visits, on the candidates."""
    study = load_study(root / file)
    return replace(study, plan=replace(study.plan, poses=DESIGNED, candidates=CANDIDATES, refine=False))


made = plan(asked(STUDY), seed=SEED)
pool, study = made.pool, made.pool.observer.study
rejected = {reason: count for reason, count in pool.candidates.rejected.items() if count}
print(
    f"the tracker stands at {study.stations[0].name}; {len(pool.blocks)} of {pool.candidates.drawn} visits are allowed"
)
print("refused:", ", ".join(f"{reason} {count}" for reason, count in rejected.items()))

# %% [markdown]
# The plan stays on the candidates here, so that both crews choose from the same list. `elastocal plan` also moves the
# poses off it, which makes the plan better still and takes longer.
#
# ## 1. What they may expect
#
# The error at the test poses that the uncertainty of the springs leaves, against the number of visits. The grey part is
# proven impossible. What would random poses be worth if the crew knew which weight to take?

# %%
rng = np.random.default_rng(SEED)


def random_values(pool, count, among=None):
    """Mean square at the test poses of some random plans of one size, mm^2; ``among`` these candidates."""
    among = np.arange(len(pool.blocks)) if among is None else among
    picks = rng.choice(among, (RANDOM_PLANS, count))
    return np.array([pool.objective.value(pool.information(pool.blocks[pick])) for pick in picks])


def equal_number(counts, medians, value):
    """How many random visits have this value in the median, between the counts by the law of one over n."""
    return float(np.exp(np.interp(-np.log(value), -np.log(medians), np.log(counts))))


counts, target = np.array(COUNTS), pool.objective.target()
designs = [exact_design(pool.blocks, target, count, effort="low", seed=SEED) for count in COUNTS]
values, bounds = (np.array([getattr(one, key) for one in designs]) for key in ("value", "bound"))
random = np.array([random_values(pool, count) for count in COUNTS])
loaded = pool.candidates.visit_loads[:, -1]
heaviest = max(set(loaded.tolist()), key=lambda load: study.loads[load].mass)
heavy = np.array([random_values(pool, count, np.flatnonzero(loaded == heaviest)) for count in COUNTS])

print("visits  impossible below   designed   random: median (10 to 90 %)    the heaviest weight only   (um rms)")
for row, count in enumerate(COUNTS):
    low, middle, high = 1e3 * np.sqrt(np.quantile(random[row], [0.1, 0.5, 0.9]))
    own, least, alone = 1e3 * np.sqrt([values[row], bounds[row], np.median(heavy[row])])
    print(f"{count:6d}{least:18.2f}{own:11.2f}{middle:17.2f} ({low:.2f} to {high:.2f}){alone:22.2f}")
view.knee(counts, *(1e3 * np.sqrt(found) for found in (values, bounds, random)), mark=DESIGNED)

# %%
of_designed = made.final.value
share = np.median(random[COUNTS.index(RANDOM)]) / of_designed
meets = equal_number(counts, np.median(random, axis=1), of_designed)
meets_heavy = equal_number(counts, np.median(heavy, axis=1), of_designed)
print(f"variance at the test poses, {RANDOM} random / {DESIGNED} designed: {share:.2f}")
print(
    f"{DESIGNED} designed visits are worth {meets:.0f} random ones, or {meets_heavy:.0f} with the heaviest weight only"
)

# %% [markdown]
# Fifteen designed visits tell about as much as sixty random ones. A part of that is the weight: the designed plan hangs
# the heaviest one all the time. The rest are the poses. And a small random plan may be unlucky, as the width of the
# band on the left shows.
#
# ## 2. What they get
#
# Both crews measure, again and again with new noise; the random crew draws new visits each time. The robot has springs
# that the plan did not know. The error at the test poses is that of the identified springs.

# %%
truth = load_truth(root / TRUTH, study)
model = model_of(study, truth.effects)
true_values = np.array([truth.values.get(name, 0.0) for name in model.names])
kept = [pool.observer.model.names[index] for index in pool.known.kept]
true_kept = np.array([truth.values[name] for name in kept])
placement = default_placement(study.noise, frame_free=study.frame_free)
weights = pool.objective.weights


def visits_of(pick):
    """Candidates as an experiment."""
    drawn = pool.candidates
    return full_experiment(drawn.visit_q[pick], drawn.visit_loads[pick], study.loads, study.markers)


def realised(experiment, seed):
    """Lengths of the errors (t,) at the test poses after one measurement and identification, um."""
    data = simulate(model, true_values, experiment, study.noise, placement, np.random.default_rng(seed))
    found = identify(study, data, seed=SEED)
    missed = np.array([found.parameters[name] for name in kept]) - true_kept
    return 1e3 * np.linalg.norm(pool.objective.rows @ missed, axis=1)


def expected(information):
    """Expected rms (t,) at the test poses, um."""
    found = accuracy(study, pool.objective.rows, covariance_of(information))
    return 1e3 * np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))


def total(lengths):
    """Rms over test poses and repetitions, um."""
    return float(np.sqrt((lengths**2 @ weights).mean()))


picks = rng.integers(len(pool.blocks), size=(REPETITIONS, RANDOM))
campaigns = [visits_of(pick) for pick in picks]
designed_campaign = full_experiment(made.q, made.visit_loads, study.loads, study.markers)
measured = {
    "designed": np.array([realised(designed_campaign, seed) for seed in range(REPETITIONS)]),
    "random": np.array([realised(one, REPETITIONS + seed) for seed, one in enumerate(campaigns)]),
}
promised = {
    "designed": expected(made.information)[None],
    "random": np.array([expected(pool.information(pool.blocks[pick])) for pick in picks]),
}
for name, count in (("designed", DESIGNED), ("random", RANDOM)):
    print(f"{count} {name}: {total(measured[name]):.2f} um rms measured, {total(promised[name]):.2f} um expected")

# %%
figure = view.canvas(2)
for axes, name in zip(figure.axes, measured):
    view.expected_and_realised(np.sqrt((promised[name] ** 2).mean(axis=0)), measured[name], axes=axes)
    axes.set_title(f"{DESIGNED if name == 'designed' else RANDOM} {name}", fontsize=9)
    axes.set_ylim(0, 1.45 * max(found.max() for found in measured.values()))
figure

# %% [markdown]
# The promise holds for both: the two campaigns know the robot equally well, within what so many repetitions can tell.
#
# ## 3. How long it takes
#
# The study says how long a pose, a reading and a crane operation take. The random crew may drive its visits as they
# were drawn, each time the unloaded state first, or let the same search as for the plan put them in order. It gets one
# more present: nobody looks whether its moves from pose to pose collide.

# %%
pick = picks[0]
blocks = pool.blocks[pick]
q, loads = pool.candidates.visit_q[pick], pool.candidates.visit_loads[pick]
anyhow = scheduled_choice(
    Choice(pool, q, loads, blocks, blocks, None, Guard(), ()),
    SEED,
    free=lambda first, second, hung: np.ones(len(first), dtype=bool),
)
hours = {
    f"{DESIGNED} designed, in order": (made.schedule.time / HOUR, made.schedule.lifts),
    f"{RANDOM} random, in order": (anyhow.time / HOUR, anyhow.lifts),
    f"{RANDOM} random, as drawn": (time_as_given(study, campaigns[0]) / HOUR, anyhow.lifts_as_found),
}
for name, (time, lifts) in hours.items():
    print(f"{name:<22}{time:5.1f} h {lifts:5d} crane operations")
hung = loads[:-1, -1]
apart = ~free_moves(study, q[:-1], q[1:]), ~free_moves(study, q[:-1], q[1:], hung)
print(
    f"of {RANDOM - 1} moves as drawn, {apart[0].sum()} collide with nothing hung, {apart[1].sum()} with the weight hung"
)

# %% [markdown]
# ## 4. Is that always so?
#
# No. How much a design gains depends on what there is to choose. The same comparison without tracker, wall and choice
# of weights, for the springs of the joints and for the complete model:

# %%
ratios = {STUDY: (len(kept), share, meets)}
for file in OTHERS:
    other = build_pool(asked(file), SEED)
    value = exact_design(other.blocks, other.objective.target(), DESIGNED, effort="low", seed=SEED).value
    medians = np.array([np.median(random_values(other, count)) for count in COUNTS])
    ratio = medians[COUNTS.index(RANDOM)] / value
    ratios[file] = (other.objective.size, ratio, equal_number(counts, medians, value))
print(f"study          parameters   variance {RANDOM} random / {DESIGNED} designed   {DESIGNED} designed are worth")
for file, (size, ratio, number) in ratios.items():
    print(f"{Path(file).stem:<18}{size:7d}{ratio:31.2f}{number:22.0f} random")

# %% [markdown]
# With one weight, sixty random visits do know more than fifteen designed ones; the design is worth about forty of
# them. So "15 instead of 60" is true in this cell and not a law of nature. What does not change: the random crew works
# several times as long.

# %%
scatter = 1.0 / np.sqrt(2 * 2 * REPETITIONS)  # of one rms: about two independent errors a repetition
fifteen = COUNTS.index(DESIGNED)
assert (bounds <= values * (1 + 1e-9)).all() and (bounds[:, None] <= random * (1 + 1e-9)).all()
assert made.final.efficiency > 0.99, "proven, on these candidates"
assert 0.9 < share < 1.3 and 50 < meets < 85, "60 random are worth about 15 designed"
assert set(made.visit_loads[:, -1].tolist()) == {heaviest}
assert meets_heavy < meets, "a part of the gain is the weight"
assert meets_heavy > 2 * DESIGNED, "the rest are the poses"
widths = np.log(np.quantile(random, 0.9, axis=1) / np.quantile(random, 0.1, axis=1))
assert widths[0] > 2 * widths[-1], "small random plans may be unlucky"
for name in measured:
    assert abs(total(measured[name]) / total(promised[name]) - 1) < 4 * scatter, name
assert abs(np.log(total(measured["designed"]) / total(measured["random"]))) < 4 * np.sqrt(2) * scatter
times = [time for time, _ in hours.values()]
assert times[1] > 3 * times[0] and times[2] > 5 * times[0]
assert made.schedule.lifts <= DESIGNED + 4 and anyhow.lifts >= RANDOM
assert apart[1].sum() > apart[0].sum() > 0
assert all(ratio < 0.8 and 30 < number < 50 for _, ratio, number in list(ratios.values())[1:]), "it is not always so"
