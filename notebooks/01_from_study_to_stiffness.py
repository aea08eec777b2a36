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
STUDY = "configs/studies/kr270.toml"  # robot, weight, reflectors, noise, test poses
TRUTH = "configs/truths/kr270.toml"  # the springs that the simulated robot really has
SEED = 0
COUNTS = [1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60]  # numbers of poses for the curve of section 2
RANDOM_PLANS = 200  # of each size
REPETITIONS = 40  # simulated measurements for section 5

# %% [markdown]
# # From a study to stiffness
#
# A KUKA KR 270 will drill with 1.5 kN. Its gears yield, so the drill misses. We may hang one weight of 250 kg on the
# flange and read three reflectors with a laser tracker.
#
# 1. Which 15 poses tell most about the springs in the joints?
# 2. Are 15 enough?
# 3. We measure. Here a simulation does it.
# 4. What are the springs, and how sure are they?
# 5. Does the accuracy come true that the plan promised?

# %%
# %matplotlib inline
from pathlib import Path

import numpy as np

from doe import exact_design, view
from doe.accuracy import accuracy
from doe.plan import plan
from identify import identify, load_study
from identify.experiment import full_experiment
from identify.model import model_of
from identify.selection import load_changes
from identify.simulate import simulate
from identify.truth import load_truth
from identify.units import MM

root = next(folder for folder in [Path.cwd(), *Path.cwd().parents] if (folder / STUDY).is_file())
study = load_study(root / STUDY)
weight = next(load for load in study.loads if not load.unloaded)
print(f"{study.robot.name}, {weight.mass:g} kg, reading noise {study.noise.reading / MM:g} mm")

# %% [markdown]
# ## 1. The plan
#
# The plan minimises the expected error at the test poses after compensation. It draws 10,000 poses that keep to joint
# limits and floor, picks the best 15, and then moves their joint angles a little. Poses that tell most may be measured
# several times.

# %%
made = plan(study, seed=SEED)
reached = accuracy(study, made.pool.objective.rows, made.covariance)
print(f"expected error at the test poses: {1e3 * reached.rms:.1f} um rms, from the springs alone")
print(f"proven: at least {100 * made.final.efficiency:.1f} % of the best that {len(made.q)} candidates can do")

# %%
view.stick_figures(study.robot, made.q, attach=weight.attach, markers=study.markers.positions[~study.markers.on_base])

# %% [markdown]
# The arms are on one scale, the weight hangs on the orange arm, the dots are reflectors. Joint 1 does not matter: its
# axis is vertical, and a weight does not turn it.
#
# The test poses look different. The plan need not visit the poses where accuracy counts.

# %%
tests = study.test_poses
view.stick_figures(
    study.robot,
    np.stack([pose.q for pose in tests]),
    attach=np.stack([pose.attach for pose in tests]),
    force=np.stack([pose.wrench[:3] for pose in tests]),
    label="test pose",
)

# %% [markdown]
# ## 2. How many poses?
#
# For every number of poses we search the best plan among the same candidates. The theory also gives a bound: no plan
# of as many poses can be better. Random poses are what people take without a planner.

# %%
pool = made.pool
target = pool.objective.target()
designs = [exact_design(pool.blocks, target, count, effort="low", seed=SEED) for count in COUNTS]
rng = np.random.default_rng(SEED)


def value_of_random(count):
    """Criterion of one plan of random candidates, mm^2."""
    rows = pool.blocks[rng.integers(len(pool.blocks), size=count)].reshape(-1, pool.objective.size)
    return pool.objective.value(rows.T @ rows)


values = np.array([design.value for design in designs])
bounds = np.array([design.bound for design in designs])
random_values = np.array([[value_of_random(count) for _ in range(RANDOM_PLANS)] for count in COUNTS])
counts = np.array(COUNTS)

own = 1e3 * np.sqrt(np.trace(reached.jitter, axis1=1, axis2=2).mean())  # um, what the robot adds by itself
rms = [1e3 * np.sqrt(found) for found in (values, bounds, random_values)]  # um

figure = view.canvas(2)
view.knee(counts, *rms, repeatability=own, mark=len(made.q), axes=figure.axes[0])
view.efficiencies(counts, bounds / values, bounds[:, None] / random_values, axes=figure.axes[1])
figure

# %% [markdown]
# The knee is at two poses. One pose cannot tell the springs apart; two chosen poses can, random ones often cannot.
# After that the error falls with one over the root of the number of poses, for every plan: twice the work for 30 %
# less error. Random poses need two to three times as many to be as good.
#
# With one to three poses the bound is loose: the plan may be the best there is although the proof says less.
#
# The dashed line is what the robot itself adds when it repeats a pose. A few well-chosen poses are already far below
# it. More of them buy certainty about the springs, hardly accuracy of the drill.
#
# ## 3. The measurement
#
# Each pose is read without and with the weight. The simulated robot has its own springs, repeats a pose only to some
# hundredths of a millimetre, and the tracker adds its noise.

# %%
truth = load_truth(root / TRUTH, study)
model = model_of(study, truth.effects)
true_values = np.array([truth.values.get(name, 0.0) for name in model.names])
experiment = full_experiment(made.q, made.visit_loads, study.loads, study.markers)


def measure(seed):
    """One simulated measurement of the whole plan; the tracker's frame is the base frame."""
    return simulate(model, true_values, experiment, study.noise, np.eye(4), np.random.default_rng(seed))


data = measure(SEED)
print(f"{len(data.positions)} readings at {len(experiment.visits)} poses")

# %% [markdown]
# ## 4. The springs
#
# The masses of the links are unknown, so only the change between unloaded and loaded readings is used.

# %%
result = identify(study, data, seed=SEED)
names = list(result.parameters)
where = [result.model.names.index(name) for name in names]
half = result.quantile * np.sqrt(np.diag(result.covariance))[where]
for name, width in zip(names, half):
    print(f"{name:<22}{result.parameters[name]:9.4f} +- {width:.4f} urad/Nm   true {truth.values[name]:g}")
print(f"{result.compensated_percent:.1f} % of the measured deflection is explained")

# %%
view.intervals(
    [f"joint {name.rpartition('.j')[2]}" for name in names],
    np.array([result.parameters[name] for name in names]),
    half,
    np.array([truth.values[name] for name in names]),
    unit="µrad/Nm",
)

# %% [markdown]
# Joint 6 is known worst, and that is on purpose: its spring hardly moves the drill at the test poses.
#
# A rigid model leaves the whole shift under load unexplained. The identified springs leave the noise.

# %%
before, rows = load_changes(experiment, result.fit.response.position + result.residuals)
errors = {
    "rigid robot": np.linalg.norm(before, axis=1) / MM,
    "identified springs": np.linalg.norm(result.misfit.error, axis=1) / MM,
}
figure = view.canvas(2)
view.error_histogram(errors, what="unexplained shift of a reflector under load", axes=figure.axes[0])
view.error_by_pose(errors, experiment.row_visit[rows], experiment.visits, what="unexplained shift", axes=figure.axes[1])
figure

# %% [markdown]
# ## 5. Was the promise kept?
#
# The plan stated an expected error before anything was measured. We repeat measurement and identification with new
# noise, and compare the drill's error at the test poses with that number. Only the springs count here; the robot's own
# repeatability comes on top.

# %%
kept = [pool.observer.model.names[index] for index in pool.known.kept]
true_kept = np.array([truth.values[name] for name in kept])
repeated = [identify(study, measure(seed), seed=SEED) for seed in range(1, REPETITIONS + 1)]
missed = np.array([[found.parameters[name] for name in kept] for found in repeated]) - true_kept
realised = 1e3 * np.linalg.norm(np.einsum("tip,kp->kti", pool.objective.rows, missed), axis=2)
expected = 1e3 * np.sqrt(np.trace(reached.covariance, axis1=1, axis2=2))
view.expected_and_realised(expected, realised)

# %%
ratio = np.sqrt((realised**2).mean() / (expected**2).mean())
widths = np.array([found.quantile * np.sqrt(np.diag(found.covariance))[where] for found in repeated])
covered = (np.abs(missed) <= widths).mean()
print(f"realised error / expected error: {ratio:.2f}")
print(f"{100 * covered:.1f} % of {missed.size} intervals of 95 % hold the true value")
print(f"rms at the test poses, springs and the robot's own repeatability: {1e3 * reached.rms_total:.0f} um")

# %% [markdown]
# The promise holds, and so do the intervals. What is left at the test poses after compensation is the repeatability
# of the robot itself: the springs now add almost nothing to it.

# %%
asked = COUNTS.index(len(made.q))
scatter = 1.0 / np.sqrt(2 * 3 * REPETITIONS)  # of a ratio of root mean squares, roughly
assert names == kept and len(names) == 5, "all joints but the first, which a hung weight cannot turn"
assert made.final.efficiency > 0.98 and (bounds <= values * (1 + 1e-9)).all()
assert made.final.value <= values[asked] * (1 + 1e-6), "off the grid the plan is no worse than on it"
assert 2 * values[COUNTS.index(2)] < values[COUNTS.index(1)], "the knee: one pose is too few"
assert np.median(random_values[asked]) > 2.0 * values[asked], "random poses: more than twice the mean square"
assert np.sqrt(reached.rms_total**2 - reached.rms**2) > 3 * reached.rms, "the robot's repeatability is what is left"
assert (np.diff(values) < 0).all(), "more poses never do harm"
assert result.compensated_percent > 98.0
assert errors["identified springs"].max() < 0.1 * errors["rigid robot"].max()
assert abs(ratio - 1.0) < 4.0 * scatter, "expected and realised error agree within sampling"
assert 0.90 <= covered <= 0.99, "intervals of 95 % hold the truth about as often"
