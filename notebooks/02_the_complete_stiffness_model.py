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
STUDY = "configs/studies/kr270_complete.toml"  # robot, weight, reflectors
JOINTS = [0.26, 0.15, 0.26, 1.8, 1.5, 2.1]  # true compliance of the joints, urad/Nm
FOOT, LINKS = 1.3, 12.0  # true links: so many times softer than plain square tubes of cast iron
SPRING = {"a_x": 0.6859, "a_y": 0.121, "radius": 0.1847}  # where the compensator's spring is hinged, m
SPRING_RATE, FREE_LENGTH = 1e7, 0.458  # N/m, m; far stronger than a real one, so that its curve stands out
LEVELS = [-100.0, -75.0, -50.0, -25.0, -5.0]  # joint 2 stands at one of these, deg
PER_LEVEL = 3  # poses at each
NOISE = 0.12  # effective noise of a measured deflection, mm per coordinate, 1 sigma
DRAWS = 12  # simulated measurements of the same poses for sections 3 and 4
SEED = 0

# %% [markdown]
# # The complete stiffness model
#
# Gears are not all that yields. Under 250 kg the links of a heavy robot bend and twist too, and springs in the joints
# cannot describe that. Klimchik, Caro, Furet and Pashkevich ("Complete Stiffness Model for a Serial Robot") give every
# link a full 6x6 compliance. That is far more than any experiment can show, so they reduce it to what counts.
#
# 1. How do 258 parameters become 26?
# 2. What do the numbers depend on?
# 3. How much better is the complete model?
# 4. What does the gravity compensator do to joint 2?
# 5. Can we go back from 26 numbers to full matrices?
# 6. What does the linear model miss?
#
# The robot is simulated. The paper's figures of a real KR 270 stand beside ours; their size should agree, not their
# digits.

# %%
# %matplotlib inline
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from doe import view
from identify import identify, load_study
from identify.equilibrium import linear_error
from identify.experiment import full_experiment
from identify.gravity_spring import SpringGeometry, spring_basis, spring_from_levels
from identify.joint_levels import joint_levels
from identify.model import model_of
from identify.response import respond
from identify.priors import beam_prior
from identify.reconstruction import identify_positive, reconstruct
from identify.reduce_command import reduced_model
from identify.reduction import reduce
from identify.selection import load_changes
from identify.simulate import simulate
from identify.study import Noise
from identify.units import MM, URAD

root = next(folder for folder in [Path.cwd(), *Path.cwd().parents] if (folder / STUDY).is_file())
study = load_study(root / STUDY)
study = replace(study, noise=Noise(reading=NOISE * MM / np.sqrt(2.0)))  # a deflection is the difference of two
weight = next(load for load in study.loads if not load.unloaded)
print(f"{study.robot.name}, {weight.mass:g} kg, reflectors {', '.join(study.markers.names)}")

# %% [markdown]
# ## 1. From 258 to 26
#
# Six joints and seven links with 36 elements each make 258 parameters. The steps of Table 1:
#
# * M1: the matrices are symmetric. M2: a beam along x has eight elements that are not zero. M3: a joint yields like the
#   end of the link before it.
# * M4: some parameters move no reflector at all. M5: the others act in groups; of each group as many are kept as the
#   readings can tell apart.
#
# No step from M2 on loses anything that the readings show.

# %%
reduction = reduce(study)
chain, groups = reduction.chain, reduction.groups
steps = ["all", "M1\nsymmetric", "M2\nbeams", "M3\njoints\ninto links", "M4\nwhat shows", "M5\nwhat is\ntold apart"]
figure = view.canvas(width=6.4)
axes = figure.axes[0]
for place, count in enumerate(chain.values()):
    axes.bar(place, count, color=view.BEFORE if place < 5 else view.AFTER, width=0.7)
    axes.text(place, count + 4, str(count), ha="center", va="bottom")
axes.set_xticks(range(len(steps)), steps, fontsize=8)
axes.set_ylabel("number of parameters")
axes.spines[["top", "right"]].set_visible(False)
figure

# %% [markdown]
# After M3 the 56 parameters fall into three groups: told by themselves (G1), moving nothing (G2), and acting only
# together with others (G3). Every parameter can be asked what became of it.


# %%
def short(names):
    return ", ".join(name.removeprefix("link_compliance.") for name in names)


print(f"G1, identifiable: {len(groups['G1'])}: {short(groups['G1'])}")
print(f"G2, not identifiable: {len(groups['G2'])}: {short(groups['G2'])}")
print(f"G3, coupled: {len(groups['G3'])} in {len(reduction.coupled)} groups")
last, first = reduction.partition.gap
print(f"smallest singular value that counts {last:.1e}, largest that does not {first:.1e}\n")
for name in ("link0.k11", "link0.k35", "link1.k55", "link2.k33", "link2.k12"):
    print(f"link_compliance.{name}: {reduction.fate(f'link_compliance.{name}')}\n")
print(f"joint_compliance.j2: {reduction.fate('joint_compliance.j2')}")

# %% [markdown]
# ## 2. What the numbers depend on
#
# 26 is no property of the robot. It belongs to a vertical load that hangs off the flange centre in all three
# directions, and to reflectors beside the load point. A weight that hangs on the axis of joint 6, or a single reflector
# at the load, shows less. Forces in all directions show more.

# %%
upright = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # beam axis of the foot along world z
turns = study.robot.link_rotations.copy()
turns[0] = upright
standing = replace(study, robot=replace(study.robot, link_rotations=turns))


def hung(point, base=study):
    """The study with its loads at another point of the flange, m."""
    return replace(base, loads=tuple(replace(load, attach=np.array(point)) for load in base.loads))


one = replace(study.markers, names=("M1",), positions=weight.attach[None], on_base=np.zeros(1, dtype=bool))
cases = {
    "as in the study": (study, (26, 1, 10, 45)),
    "weight at y = 0": (hung((0.3, 0.0, -0.1)), (25, 1, 10, 45)),
    "weight at the flange centre": (hung((0.0, 0.0, 0.0)), (22, 1, 14, 41)),
    "one reflector, at the load": (replace(study, markers=one), (24, 1, 10, 45)),
    "foot as an upright beam": (standing, (27, 2, 9, 45)),
    "the same, weight on axis 6": (hung((0.3, 0.0, 0.0), standing), (23, 2, 11, 43)),
    "forces in all directions": (replace(study, reduce=replace(study.reduce, directions="forces")), (32, 2, 0, 54)),
}
counted = {name: reduce(case).partition.counts for name, (case, _) in cases.items()}
print(f"{'':<29}{'rank':>5}{'G1':>5}{'G2':>5}{'G3':>5}")
for name, numbers in counted.items():
    print(f"{name:<29}" + "".join(f"{number:5d}" for number in numbers))

# %% [markdown]
# ## 3. Five springs against 26 parameters
#
# The simulated robot has yielding joints, soft links, and a spring beside joint 2 that changes the stiffness of this
# joint with its angle. It is loaded in 15 poses, three at each of five angles of joint 2. Four models are fitted:
#
# * J1: joint compliances. J2: the same, joint 2 with a value of its own at each of the five angles.
# * C1: the complete model of section 1. C2: the same with five values for joint 2.
#
# Joint 1 cannot be told by a weight, so J1 has five parameters.

# %%
prior = beam_prior(study.robot)
geometry, at = SpringGeometry(**SPRING), np.radians(LEVELS)


def stiffness(q):
    """True stiffness of joint 2 at joint values (C,), rad: its own and the spring's, Nm/rad."""
    return 1.0 / (JOINTS[1] * URAD) + spring_basis(geometry, q)[1] @ [SPRING_RATE, SPRING_RATE * FREE_LENGTH]


def variant(*effects):
    return replace(
        study,
        effects=effects,
        options={
            "link_compliance": {"template": "beam"},
            "gravity_compensator": {"levels_deg": LEVELS},
        },
    )


def kept_only(base, reduction):
    """The study that fits exactly the parameters that a reduction keeps."""
    tables = reduced_model(base, reduction)
    options = {**base.options, "link_compliance": tables["link_compliance"]}
    return replace(base, effects=tuple(tables["effects"]), options=options)


def true_value(name):
    """True value of a parameter of the twin in its unit."""
    owner, _, element = name.removeprefix("link_compliance.").rpartition(".")
    if name.startswith("joint_compliance."):
        return JOINTS[int(element[1:]) - 1]
    if name.startswith("gravity_compensator."):
        return (1.0 / stiffness(at[int(element[1:]) - 1 :][:1]).item() - JOINTS[1] * URAD) / URAD
    if not owner.startswith("link"):
        return 0.0
    number, row, column = int(owner[4:]), int(element[1]) - 1, int(element[2]) - 1
    return (LINKS if number else FOOT) * prior.links[number][row, column] / URAD


def poses(rng, count):
    """Random joint values, joint 2 on its levels."""
    q = rng.uniform(study.robot.lower, study.robot.upper, (count * len(LEVELS), study.robot.n))
    q[:, 1] = np.repeat(at, count)
    return q


def experiment_at(q):
    return full_experiment(q, np.tile([0, 1], (len(q), 1)), study.loads, study.markers)


def measure(experiment, seed, noise=study.noise):
    return simulate(twin, true_values, experiment, noise, np.eye(4), np.random.default_rng(seed))


twin = model_of(variant("joint_compliance", "link_compliance", "gravity_compensator@j2"))
true_values = np.array([true_value(name) for name in twin.names])
wide = poses(np.random.default_rng(99), 12)
with_levels = reduce(variant("link_compliance", "gravity_compensator@j2"), poses=wide)
models = {
    "J1": variant("joint_compliance"),
    "J2": variant("joint_compliance", "gravity_compensator@j2"),
    "C1": kept_only(variant("link_compliance"), reduction),
    "C2": kept_only(variant("link_compliance", "gravity_compensator@j2"), with_levels),
}
experiment = experiment_at(poses(np.random.default_rng(SEED), PER_LEVEL))
others = experiment_at(poses(np.random.default_rng(SEED + 1), PER_LEVEL))  # never used for a fit

# %% [markdown]
# Each model is fitted to several simulated measurements of the same poses. The last column is the error at 15 other
# poses that no fit has seen, against readings with the same noise.


# %%
def rms(vectors):
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


fits = {name: [] for name in models}
unseen = {name: [] for name in models}
for draw in range(DRAWS):
    data, check = measure(experiment, draw), measure(others, 1000 + draw)
    for name, asked in models.items():
        found = identify(asked, data, seed=SEED)
        fits[name].append(found)
        predicted = respond(found.model, others, found.values, derivative=False).position
        unseen[name].append(rms(load_changes(others, check.positions - predicted)[0]) / MM)

PAPER = {"none": 4.58, "J1": 0.75, "J2": 0.73, "C1": 0.22, "C2": 0.21}  # positional rms, mm
before = np.array([found.deflection[0].rms for found in fits["J1"]]) / MM
left = {name: np.array([found.deflection[1].rms for found in fits[name]]) / MM for name in models}
average = {"none": before.mean(), **{name: values.mean() for name, values in left.items()}}
compensated = {name: np.mean([found.compensated_percent for found in fits[name]]) for name in models}
sizes = {name: len(fits[name][0].parameters) for name in models}
print("          parameters   left, rms    compensated     paper: rms   compensated    other poses, rms")
print(f"none{'-':>13}{average['none']:12.2f} mm{PAPER['none']:26.2f} mm")
for name in models:
    published = 100.0 * (1.0 - PAPER[name] / PAPER["none"])
    print(
        f"{name:<4}{sizes[name]:>13}{average[name]:12.3f} mm{compensated[name]:12.1f} %{PAPER[name]:12.2f} mm"
        f"{published:12.1f} %{np.mean(unseen[name]):17.3f} mm"
    )

# %% [markdown]
# Joints alone leave three quarters of a millimetre, and a value of joint 2 for every angle hardly helps. The links make
# the difference. Our robot deflects more than the paper's, so the same rests are smaller percentages.
#
# The paper shows fitted poses only. At other poses the complete model loses a little, for 15 poses are few for 26
# parameters; it stays far ahead. The values per angle of joint 2 (J2, C2) pay at fitted poses; at others they cost
# about as much as they bring.
#
# What the joints-only model leaves is no noise: its residuals are wider than a normal distribution of the stated noise.
# Those of the complete model have the width of the noise.

# %%
shown = {name: load_changes(experiment, fits[name][0].residuals)[0] / MM for name in ("J2", "C2")}
lengths = {
    "rigid robot": fits["C2"][0].deflection[0].error / MM,
    "joints only (J2)": shown["J2"],
    "complete (C2)": shown["C2"],
}
figure = view.canvas(2)
_, loaded = load_changes(experiment, fits["C2"][0].residuals)
view.error_by_pose(
    {name: np.linalg.norm(rows, axis=1) for name, rows in lengths.items()},
    experiment.row_visit[loaded],
    experiment.visits,
    what="unexplained shift",
    axes=figure.axes[0],
)
figure.axes[0].legend(frameon=False, fontsize=8, loc="lower left", ncols=3, columnspacing=1.0, handletextpad=0.2)
figure.axes[0].set_ylim(bottom=0.06)
axes = figure.axes[1]
edges = np.linspace(-1.0, 1.0, 34) * 1.05 * np.abs(shown["J2"]).max()
for name, colour in (("J2", "#17708a"), ("C2", "#8d5a97")):  # as in the left panel
    every = np.concatenate([load_changes(experiment, found.residuals)[0] for found in fits[name]]).ravel() / MM
    axes.hist(every, bins=edges, density=True, histtype="stepfilled", alpha=0.45, color=colour)
    axes.plot([], [], color=colour, lw=6, alpha=0.45, label=f"{name}, {DRAWS} measurements")
line = np.linspace(edges[0], edges[-1], 400)
axes.plot(line, stats.norm.pdf(line, scale=NOISE), color=view.TRUTH, lw=1.2, label="stated noise")
axes.set_xlabel("unexplained shift along x, y or z (mm)")
axes.set_ylabel("density (1/mm)")
axes.legend(frameon=False, fontsize=8)
axes.spines[["top", "right"]].set_visible(False)
figure

# %%
for name, rows in shown.items():
    print(f"{name}: normal distribution (Shapiro-Wilk), p = {stats.shapiro(rows.ravel()).pvalue:.2g}")
for name in models:
    print(f"{name}: chi2 says that model and stated noise fit, p = {fits[name][0].lack_of_fit.p_value:.2g}")

# %% [markdown]
# ## 4. The spring beside joint 2
#
# A gravity compensator is a spring from the carousel to the upper arm. It adds to the stiffness of joint 2, and how
# much depends on the angle q2. With known hinges this stiffness is linear in three numbers, so five angles give a fit
# with two equations to spare.
#
# The foot turns the arm nearly as joint 2 does: 15 poses tell only their sum. So the foot is taken from the beam
# formula (it is 30 % softer in truth). And what is found for joint 2 contains the bending of the links that cannot be
# told from it, the same amount at every angle. Perfect readings would give just that sum, the line "truth" below.

# %%
tables = models["C2"].options["link_compliance"]
foot = {f"link0.{key}": prior.links[0][int(key[1]) - 1, int(key[2]) - 1] / URAD for key in ("k35", "k44", "k55")}
held = replace(
    models["C2"],
    options={
        **models["C2"].options,
        "link_compliance": {**tables, "link0": {"template": []}, "constants": {**tables.get("constants", {}), **foot}},
    },
)
each = [joint_levels(identify(held, measure(experiment, draw), seed=SEED)) for draw in range(DRAWS)]
mean = np.mean([found.compliance for found in each], axis=0)
averaged = each[0]._replace(compliance=mean, covariance=np.mean([found.covariance for found in each], axis=0) / DRAWS)
faint = Noise(reading=1e-9)
perfect = joint_levels(identify(replace(held, noise=faint), measure(experiment_at(wide), 0, faint), seed=SEED))
share = perfect.compliance - 1.0 / stiffness(at)  # of the links, rad/Nm
springs = [spring_from_levels(*levels, geometry) for levels in (each[0], averaged)]
print(f"links in it: {share.mean() / URAD:.3f} urad/Nm, the same at all angles to {np.ptp(share) / URAD:.1g}")
p_values = [stats.chi2.sf(spring.chi2, spring.dof) for spring in springs]
for times, spring, p_value in zip((1, DRAWS), springs, p_values):
    print(f"measured {times:2d} x: chi2 {spring.chi2:.2f}, {spring.dof} degrees of freedom, p = {p_value:.2f}")

# %%
MEGA = 1e6
q = np.radians(np.linspace(-105.0, 0.0, 106))
rows = np.column_stack([np.ones(len(q)), spring_basis(geometry, q)[1]])
truth_curve = 1.0 / (1.0 / stiffness(q) + share.mean())
curves, widths = [], []
figure = view.canvas(2)
for axes, times, levels, spring in zip(figure.axes, (1, DRAWS), (each[0], averaged), springs):
    curve = rows @ [spring.stiffness, spring.spring, spring.preload]
    width = 1.96 * np.sqrt(np.einsum("ci,ij,cj->c", rows, spring.covariance, rows))
    found, half = 1.0 / levels.compliance, 1.96 * np.sqrt(np.diag(levels.covariance)) / levels.compliance**2
    blue, at_levels = view.AFTER, np.degrees(levels.q)
    axes.fill_between(np.degrees(q), (curve - width) / MEGA, (curve + width) / MEGA, color=blue, alpha=0.15, lw=0)
    axes.plot(np.degrees(q), curve / MEGA, color=blue, lw=1.6, label="spring fitted to the levels, 95 %")
    axes.errorbar(at_levels, found / MEGA, yerr=half / MEGA, fmt="o", color=blue, ms=4, capsize=3, label="levels, 95 %")
    axes.plot(np.degrees(q), truth_curve / MEGA, color=view.TRUTH, lw=1.2, ls=(0, (4, 2)), label="truth")
    axes.set_title("one measurement" if times == 1 else f"mean of {times} measurements", fontsize=9)
    axes.set_xlabel("joint 2 (deg)")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_ylim(2.2, 2.95)
    curves.append(curve)
    widths.append(width)
figure.axes[0].set_ylabel("stiffness of joint 2 (MNm/rad)")
figure.axes[0].legend(frameon=False, fontsize=8, loc="upper right")
figure

# %% [markdown]
# One measurement of 15 poses does not show the curve: the levels share a large error, and the spring's part is small.
# The mean of many measurements does. Here the spring is many times stronger than a real one is likely to be; changes
# under load will hardly show that. (Absolute readings show a spring far better, by the torque that it holds.)
#
# ## 5. Back to full matrices
#
# The paper leaves this to the future. 30 numbers do not determine the matrices of seven links, but the matrices must be
# positive definite, for a body that gains energy when loaded does not exist. Of all such matrices that agree with what
# was identified we take those closest to a prior: plain square tubes and joints sized for the payload. What is left
# free is said as an interval.
#
# Noise can push the 30 numbers out of what positive definite matrices can have. Then they are fitted again inside.

# %%
positive = identify_positive(fits["C2"][0], prior, reduction=with_levels)
matrices = reconstruct(positive.identified, prior, intervals=())
print(f"chi2 rises by {positive.chi2_increase:.2f}; farthest from positive definite was {positive.worst or 'none'}")
for number, link in matrices.links.items():
    used = np.flatnonzero(np.diag(link))
    size = np.sqrt(np.diag(link)[used])
    least = np.linalg.eigvalsh(link[np.ix_(used, used)] / np.outer(size, size))[0]
    print(f"link {number}: {len(used)} x {len(used)}, smallest eigenvalue of the matrix with unit diagonal {least:.1e}")

# %% [markdown]
# What stays free even with perfect readings? Each bar holds all values that one element can have while all readings
# stay as they are and all matrices positive definite. Short bars are known, long ones are not.

# %%
perfect_fit = identify(replace(models["C2"], noise=faint), measure(experiment_at(wide), 0, faint), seed=SEED)
exact = identify_positive(perfect_fit, prior, reduction=with_levels).identified
asked = [f"joint_compliance.j{i}" for i in range(1, 7)]
asked += [f"link_compliance.link{i}.{key}" for i in (0, 2, 3, 6) for key in ("k33", "k44", "k55", "k66")]
free = reconstruct(exact, prior, intervals=asked, bound=20.0)  # nothing beyond 20 times what is expected
bounds = np.array([free.intervals[name] for name in asked])
middle = np.array([free.parameters[name] for name in asked])
truths = np.array([true_value(name) for name in asked])
expected = free.prior[[free.identified.full.index(name) for name in asked]]

# %%
least = 1e-3  # urad/Nm, um/N; bars that reach zero end here
figure = view.canvas(width=7.0, height=5.2)
axes = figure.axes[0]
place = np.arange(len(asked))
low = np.maximum(bounds[:, 0], least)
axes.barh(place, bounds[:, 1] - low, left=low, height=0.55, color=view.PALE, label="what is possible")
axes.plot(expected, place, "|", color=view.BEFORE, ms=9, mew=1.6, label="prior")
axes.plot(middle, place, "o", color=view.AFTER, ms=4.5, label="reconstructed")
axes.plot(truths, place, "x", color=view.TRUTH, ms=6, label="truth")
axes.set_xscale("log")
axes.set_xlim(left=0.9 * least)
axes.set_yticks(place, [name.split(".", 1)[1].replace(".", " ").replace("j", "joint ") for name in asked], fontsize=8)
axes.invert_yaxis()
axes.set_xlabel("compliance (µrad/Nm; k33: µm/N); bars that end at the left edge reach zero")
axes.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
axes.spines[["top", "right"]].set_visible(False)
figure

# %% [markdown]
# k33 of the forearm (link 3) is known to within some per cent, the wrist joints to a factor of some units. A joint and
# the link before it share what they do: joints 1 to 3 could as well be rigid and the links softer. Who needs one number
# of such a pair must know the other, or load the arm in other directions.
#
# ## 6. What the linear model misses
#
# All this takes deflections as proportional to the load. A loaded arm settles in a deflected pose, where its lever arms
# are others. How much is that?

# %%
linear = linear_error(twin, experiment, true_values)
print(f"the linear model misses {1e3 * linear.rms / MM:.0f} um rms, at most {1e3 * linear.maximum / MM:.0f} um")
print(f"that is {linear.percent:.2f} % of the deflection, and a noise of {1e3 * NOISE:.0f} um hides it")

# %%
assert list(chain.values()) == [258, 153, 62, 56, 46, 26]
assert [len(groups[group]) for group in ("G1", "G2", "G3")] == [1, 10, 45]
assert all(counted[name] == wanted for name, (_, wanted) in cases.items()), "every sensitivity of section 2"
assert sizes == {"J1": 5, "J2": 9, "C1": 26, "C2": 30}, "the parameters of Table 2"
assert average["none"] > average["J1"] > average["J2"] > average["C1"] > average["C2"], "the order of Table 2"
assert all(75.0 < compensated[name] < 92.0 for name in ("J1", "J2"))
assert all(compensated[name] > 95.0 for name in ("C1", "C2"))
assert max(np.mean(unseen[name]) for name in ("C1", "C2")) < 0.6 * min(np.mean(unseen[name]) for name in ("J1", "J2"))
assert all(found.lack_of_fit.p_value < 1e-6 for found in fits["J2"]), "joints alone are rejected every time"
assert np.median([found.lack_of_fit.p_value for found in fits["C2"]]) > 0.05, "the complete model is not"
assert min(p_values) > 0.001, "a spring describes the levels"
assert all((np.abs(curve - truth_curve) < 1.6 * width).all() for curve, width in zip(curves, widths))
assert (share > 0).all() and np.ptp(share) < 0.05 * share.mean()
assert all(np.linalg.eigvalsh(link)[0] > 0 for link in matrices.links.values())
assert min(matrices.smallest.values()) > 0 and matrices.disagreement < 1e-8
slack = 1e-4 * truths
assert (bounds[:, 0] - slack <= truths).all() and (truths <= bounds[:, 1] + slack).all(), "the truth is possible"
assert linear.percent < 1.0
