"""Back to full matrices: random truths, held-out deflections, freedom, what cannot be, and the constrained fit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from reference_robots import gantry, kr270, mixed, seven_joints, study_of

from identify.beams import Box, Tube, box_compliance, tube_compliance
from identify.cone_extremes import extremes
from identify.cone_problems import affine, inside
from identify.errors import Infeasible, InputError, NoConvergence
from identify.experiment import full_experiment
from identify.identification import identify
from identify.identified import Identified, identified_by_fit, identified_values
from identify.model import model_of
from identify.observation import observation_matrix, random_configurations
from identify.partition import coupling
from identify.positive_cone import cone_of
from identify.priors import Prior, beam_prior, link_boxes
from identify.reconstruction import MARGIN, identify_positive, reconstruct
from identify.reduce_command import reduced_model
from identify.reduction import complete_model, reduce
from identify.response import respond
from identify.simulate import simulate
from identify.study import Noise

FORCE = 2500.0  # N
LOADS = study_of(kr270()).loads


def case_of(robot, prior, **settings):
    """A robot with its reduction, and the observation matrix of the stage before aggregation at new poses."""
    study = study_of(robot, **settings)
    reduction = reduce(study)
    q = random_configurations(study, 40, np.random.default_rng(99))
    unseen = observation_matrix(study, complete_model(study), q)
    for step in reduction.steps[:2]:
        unseen = unseen @ step.expand
    cone = cone_of(reduction.steps[1].after, prior)
    return SimpleNamespace(study=study, reduction=reduction, prior=prior, unseen=unseen, cone=cone)


@pytest.fixture(scope="module")
def heavy():
    return case_of(kr270(), beam_prior(kr270()))


def random_truth(cone, rng, spread=0.5):
    """Matrices scattered around the prior: ``C G G' C'`` with its Cholesky factor C, in result units."""
    y = np.zeros(len(cone.names))
    for block in cone.blocks:
        size, used = len(block.columns), block.columns >= 0
        factor = np.linalg.cholesky(block.matrices(cone.prior))
        wild = rng.normal(size=(size, size + 2))
        matrix = factor @ (0.3 * np.eye(size) + 0.7 * wild @ wild.T / (size + 2)) @ factor.T
        y[block.columns[used]] = (np.exp(rng.normal(0, spread)) * matrix)[used]
    return cone.scale * y


def identified_from(case, truth, covariance=None):
    full = truth
    for step in reversed(case.reduction.steps[:2]):
        full = step.expand @ full
    return identified_values(case.reduction, case.reduction.reduced(full), covariance)


def positive_definite(found):
    for link in found.links.values():
        used = np.flatnonzero(np.diag(link))
        size = np.sqrt(np.diag(link)[used])
        np.testing.assert_array_equal(link, link.T)
        assert np.linalg.eigvalsh(link[np.ix_(used, used)] / np.outer(size, size))[0] > 0
    assert all(value > 0 for name, value in found.parameters.items() if name.startswith("joint_compliance"))
    assert min(found.smallest.values()) > 0.5 * MARGIN


# ---- beams


def test_a_slender_box_bends_like_the_textbook_and_a_stubby_one_shears():
    slender = box_compliance(Box(10.0, 0.1, 0.01, young=210e9, poisson=0.3))
    inertia = (0.1**4 - 0.08**4) / 12
    assert slender[1, 1] == pytest.approx(1000 / (3 * 210e9 * inertia), rel=1e-3)
    assert slender[5, 5] == pytest.approx(10 / (210e9 * inertia))
    assert slender[0, 0] == pytest.approx(10 / (210e9 * (0.1**2 - 0.08**2)))
    stubby = box_compliance(Box(0.05, 0.1, 0.01, young=210e9, poisson=0.3))
    shear = 0.05 / (20 * 1.3 / (48 + 39 * 0.3) * 210e9 / 2.6 * (0.1**2 - 0.08**2))
    assert stubby[1, 1] == pytest.approx(shear + 0.05**3 / (3 * 210e9 * inertia))
    assert shear > 0.9 * stubby[1, 1]


def test_box_and_tube_have_the_same_pattern_and_signs():
    box, tube = box_compliance(Box(1.0, 0.2, 0.01)), tube_compliance(Tube(1.0, 0.2, 0.01))
    np.testing.assert_array_equal(np.sign(box), np.sign(tube))
    assert np.linalg.eigvalsh(box)[0] > 0


def test_the_torsion_of_a_box_follows_bredt():
    box = Box(1.0, 0.2, 0.002)
    middle = 0.198
    constant = 4 * (middle**2) ** 2 / (4 * middle / 0.002)
    assert box_compliance(box)[3, 3] == pytest.approx(1.0 / (box.young / (2 * (1 + box.poisson)) * constant))


@pytest.mark.parametrize("wrong", [{"length": 0.0}, {"wall": -0.1}, {"side": float("nan")}, {"wall": 0.2}])
def test_impossible_boxes_are_refused(wrong):
    with pytest.raises(InputError):
        replace(Box(1.0, 0.3, 0.02), **wrong)


def test_the_prior_of_a_heavy_arm_has_the_published_order_of_magnitude():
    prior = beam_prior(kr270())
    quoted = np.array([0.302, 0.406, 3.002, 3.303, 2.365]) * 1e-6
    assert (np.abs(np.log(prior.joints[1:] / quoted)) < np.log(2)).all()
    arm = prior.links[2:4]
    assert ((arm[:, 1, 1] > 2e-9) & (arm[:, 1, 1] < 5e-8)).all()
    assert ((arm[:, 4, 4] > 1e-8) & (arm[:, 4, 4] < 2e-7)).all()


def test_a_prior_that_is_not_possible_is_refused():
    good = beam_prior(kr270())
    with pytest.raises(InputError, match="joint 2"):
        Prior(good.links, np.where(np.arange(6) == 1, 0.0, good.joints))
    broken = good.links.copy()
    broken[3, 1, 5] = broken[3, 5, 1] = 1.0
    with pytest.raises(InputError, match="link 3"):
        Prior(broken, good.joints)
    with pytest.raises(InputError, match="shape"):
        Prior(good.links[:5], good.joints)
    with pytest.raises(InputError, match="payload"):
        beam_prior(mixed())
    with pytest.raises(InputError, match="boxes"):
        beam_prior(kr270(), link_boxes(kr270())[1:])


# ---- reconstruction


def test_200_random_truths_give_positive_definite_matrices_that_predict_unseen_poses(heavy):
    rng, hard = np.random.default_rng(0), 0
    for _ in range(200):
        truth = random_truth(heavy.cone, rng)
        identified = identified_from(heavy, truth)
        found = reconstruct(identified, heavy.prior, intervals=())
        positive_definite(found)
        assert found.disagreement < 1e-10
        error = heavy.unseen @ (found.values - truth)
        assert np.linalg.norm(error) < 1e-6 * np.linalg.norm(heavy.unseen @ truth)
        near = affine(identified.matrix * heavy.cone.scale, identified.values, heavy.cone.prior, heavy.cone.weight)
        hard += not inside(heavy.cone, near.point, MARGIN)
    assert hard > 50  # many of them need the cone


def test_what_was_identified_is_what_the_columns_can_tell(heavy):
    """The functions follow from the observation matrix itself: ``A = A_kept (kept + shares of the dropped)``."""
    identified = identified_from(heavy, np.zeros(len(heavy.cone.names)))
    names = heavy.reduction.steps[1].after
    kept = np.array([names.index(name) for name in heavy.reduction.kept])
    shares = coupling(heavy.unseen, kept)
    np.testing.assert_allclose(identified.matrix, shares, rtol=1e-5, atol=1e-5)


def test_the_truth_lies_within_the_reported_freedom(heavy):
    rng = np.random.default_rng(5)
    for _ in range(2):
        truth = random_truth(heavy.cone, rng)
        found = reconstruct(identified_from(heavy, truth), heavy.prior)
        room = 1e-5 * heavy.cone.scale
        assert (found.lower - room <= truth).all()
        assert (truth <= found.upper + room).all()
        assert (found.lower <= found.values).all()
        assert (found.values <= found.upper).all()
        assert np.isfinite(found.upper).all()
        low, high = found.intervals["link_compliance.link0.k35"]  # G1
        assert high - low < 1e-9 * abs(low)
        low, high = found.intervals["link_compliance.link2.k22"]  # G2
        assert high - low > 5 * found.parameters["link_compliance.link2.k22"]


def test_freedom_is_computed_for_what_is_asked(heavy):
    identified = identified_from(heavy, random_truth(heavy.cone, np.random.default_rng(1)))
    every = reconstruct(identified, heavy.prior)
    some = reconstruct(identified, heavy.prior, intervals=["joint_compliance.j2"])
    assert set(some.intervals) == {"joint_compliance.j2"}
    np.testing.assert_allclose(some.intervals["joint_compliance.j2"], every.intervals["joint_compliance.j2"], rtol=1e-5)
    wider = reconstruct(identified, heavy.prior, intervals=["link_compliance.link2.k22"], bound=20.0)
    assert wider.intervals["link_compliance.link2.k22"][1] > every.intervals["link_compliance.link2.k22"][1]
    with pytest.raises(InputError, match="no such parameter"):
        reconstruct(identified, heavy.prior, intervals=["joint_compliance.j9"])
    with pytest.raises(InputError, match="bound"):
        reconstruct(identified, heavy.prior, bound=0.5)


def test_a_prior_that_is_true_comes_back(heavy):
    truth = heavy.cone.scale * heavy.cone.prior
    found = reconstruct(identified_from(heavy, truth), heavy.prior, intervals=())
    np.testing.assert_allclose(found.values, truth, rtol=1e-9)
    for number, link in found.links.items():
        np.testing.assert_allclose(link, heavy.prior.links[number], atol=1e-9 * np.abs(link).max())


def test_the_answer_is_the_closest_to_the_prior(heavy):
    """No step towards another possible answer comes closer."""
    rng, cone = np.random.default_rng(3), heavy.cone
    truth = random_truth(cone, rng)
    found = reconstruct(identified_from(heavy, truth), heavy.prior, intervals=())
    y, away = found.values / cone.scale, cone.weight**2
    for other in (truth / cone.scale, 0.5 * (truth / cone.scale + y)):
        assert away * (y - cone.prior) @ (other - y) > -1e-6 * (away @ (y - cone.prior) ** 2)


def test_units_of_the_prior_do_not_matter(heavy):
    """Loads in kN and compliances in m/N: the same matrices."""
    truth = random_truth(heavy.cone, np.random.default_rng(8))
    identified = identified_from(heavy, truth)
    found = reconstruct(identified, heavy.prior, intervals=())
    rows = np.diag(10.0 ** np.linspace(-6, 6, len(identified.names)))
    other = replace(identified, matrix=rows @ identified.matrix, values=rows @ identified.values)
    again = reconstruct(other, heavy.prior, intervals=())
    np.testing.assert_allclose(again.values / heavy.cone.scale, found.values / heavy.cone.scale, atol=1e-5)


@pytest.mark.parametrize("template", ["symmetric", {"template": "beam", "link2": {"template": ["k55", "k66", "k35"]}}])
def test_other_templates(template):
    case = case_of(kr270(), beam_prior(kr270()), template=template)
    rng = np.random.default_rng(2)
    for _ in range(3):
        truth = random_truth(case.cone, rng)
        found = reconstruct(identified_from(case, truth), case.prior, intervals=())
        positive_definite(found)
        assert np.linalg.norm(case.unseen @ (found.values - truth)) < 1e-6 * np.linalg.norm(case.unseen @ truth)


@pytest.mark.parametrize("make", [gantry, seven_joints, mixed])
def test_other_robots(make):
    robot = make()
    joints = np.full(robot.n, 1e-5)
    case = case_of(robot, beam_prior(robot, joints=joints))
    rng = np.random.default_rng(4)
    for _ in range(3):
        truth = random_truth(case.cone, rng)
        found = reconstruct(identified_from(case, truth), case.prior, intervals=())
        positive_definite(found)
        assert np.linalg.norm(case.unseen @ (found.values - truth)) < 1e-6 * np.linalg.norm(case.unseen @ truth)


def test_levels_of_a_compensator_are_parameters_like_others(heavy):
    """Model C2: 30 parameters, five of them joint 2 at each level; its own compliance and the levels share freedom."""
    options = {"link_compliance": {"template": "beam"},
               "gravity_compensator": {"j2": {"levels_deg": [-100.0, -75.0, -50.0, -25.0, -5.0]}}}  # fmt: skip
    reduction = reduce(replace(heavy.study, options=options, effects=("link_compliance", "gravity_compensator@j2")))
    assert reduction.rank == 30
    known = dict(zip(heavy.cone.names, heavy.cone.scale * heavy.cone.prior, strict=True))
    truth = np.array([known.get(name, 0.01) for name in reduction.steps[1].after])
    found = reconstruct(identified_from(SimpleNamespace(reduction=reduction), truth), heavy.prior)
    positive_definite(found)
    assert found.disagreement < 1e-10
    room = 1e-5 * np.abs(truth)
    assert (found.lower - room <= truth).all()
    assert (truth <= found.upper + room).all()


def pair_of_springs():
    """A link with k22, k66 and k26 and nothing identified: |y26| <= sqrt(y22 y66)."""
    cone = cone_of(tuple(f"link_compliance.link1.{key}" for key in ("k22", "k66", "k26")), beam_prior(kr270()))
    box = np.array([4.0, 9.0, np.inf])
    return cone, affine(np.zeros((0, 3)), np.zeros(0), cone.prior, cone.weight), (-box, box)


def test_the_freedom_of_a_pair_of_springs_has_a_closed_form():
    cone, space, box = pair_of_springs()
    low, high = extremes(cone, space, 0.0, box, [0, 1, 2])
    np.testing.assert_allclose(low, [0, 0, -6], atol=1e-5)
    np.testing.assert_allclose(high, [4, 9, 6], atol=1e-5)


def test_an_inaccurate_solver_widens_intervals_and_never_narrows_them(monkeypatch):
    """Stopped at gaps of 10 %, the solver's own values lie anywhere near the ends; what is proven lies outside."""
    loose = {"tol_gap_abs": 0.1, "tol_gap_rel": 0.1, "tol_feas": 1e-4, "tol_ktratio": 0.1}
    monkeypatch.setattr("identify.cone_problems._ATTEMPTS", (loose,))
    monkeypatch.setattr("identify.cone_extremes._LOSS", 10.0)
    cone, space, box = pair_of_springs()
    low, high = extremes(cone, space, 0.0, box, [0, 1, 2])
    assert (low <= [0, 0, -6]).all()
    assert (high >= [4, 9, 6]).all()
    assert max(high - [4, 9, 6]) > 1e-3, "the solver was inaccurate"
    monkeypatch.setattr("identify.cone_problems._ATTEMPTS", (loose, {}))
    _, better = extremes(cone, space, 0.0, box, [0, 1, 2])
    np.testing.assert_allclose(better, [4, 9, 6], atol=1e-3)
    assert max(better - [4, 9, 6]) < 0.1 * max(high - [4, 9, 6])


def test_a_solver_that_gives_up_is_asked_again_with_more_care(monkeypatch):
    """Three iterations are too few; the next settings solve it."""
    cone, space, box = pair_of_springs()
    monkeypatch.setattr("identify.cone_problems._ATTEMPTS", ({"max_iter": 3}, {"max_step_fraction": 0.9}))
    _, high = extremes(cone, space, 0.0, box, [2])
    assert high[0] == pytest.approx(6.0, abs=1e-5)
    monkeypatch.setattr("identify.cone_problems._ATTEMPTS", ({"max_iter": 3},))
    with pytest.raises(NoConvergence, match=r"no bound of link_compliance\.link1\.k26"):
        extremes(cone, space, 0.0, box, [2])


# ---- what cannot be


def test_values_that_no_matrix_can_have_are_refused_with_the_worst_link_and_the_distance(heavy):
    wrong = random_truth(heavy.cone, np.random.default_rng(6))
    for name in ("link_compliance.link6.k55", "link_compliance.link6.k33", "link_compliance.link6.k66"):
        wrong[heavy.cone.names.index(name)] = -50.0
    exact = identified_from(heavy, wrong)
    with pytest.raises(Infeasible, match="link6 is the worst") as caught:
        reconstruct(exact, heavy.prior)
    assert caught.value.exit_code == 3
    assert "% of the prior's size" in str(caught.value)
    std = 0.1
    known = replace(exact, covariance=std**2 * np.eye(len(exact.names)))
    with pytest.raises(Infeasible, match=r"would have to move by \S+ std"):
        reconstruct(known, heavy.prior)
    blind = replace(known, covariance=np.outer(*[np.linspace(0.1, 1, len(exact.names))] * 2))  # one pose
    with pytest.raises(Infeasible, match=r"would have to move by \S+ std"):
        reconstruct(blind, heavy.prior)


def test_constants_that_break_positive_definiteness_are_refused(heavy):
    truth = random_truth(heavy.cone, np.random.default_rng(7))
    identified = identified_from(heavy, truth)
    held = {"link_compliance.link2.k22": 0.001, "link_compliance.link2.k66": 0.001, "link_compliance.link2.k26": 0.5}
    with pytest.raises(Infeasible, match="link2") as caught:
        reconstruct(identified, heavy.prior, fixed=held)
    assert caught.value.exit_code == 3
    with pytest.raises(Infeasible, match="constants break"):
        reconstruct(identified, heavy.prior, fixed={"link_compliance.link1.k22": -0.01})
    with pytest.raises(Infeasible, match="contradict what was identified"):
        reconstruct(identified, heavy.prior, fixed={"link_compliance.link0.k35": 0.0})
    with pytest.raises(InputError, match="no such parameter"):
        reconstruct(identified, heavy.prior, fixed={"link9.k11": 1.0})


def test_constants_are_kept(heavy):
    truth = random_truth(heavy.cone, np.random.default_rng(7))
    held = {name: truth[heavy.cone.names.index(name)] for name in heavy.cone.names if ".link2." in name}
    found = reconstruct(identified_from(heavy, truth), heavy.prior, fixed=held, intervals=held)
    for name, value in held.items():
        assert found.parameters[name] == pytest.approx(value, rel=1e-9, abs=1e-12)
        assert found.intervals[name] == pytest.approx((value, value), rel=1e-9, abs=1e-12)


def test_mirrored_elements_and_wrong_shapes_are_refused(heavy):
    both = ("link_compliance.link1.k26", "link_compliance.link1.k62")
    with pytest.raises(InputError, match="symmetric template"):
        cone_of(both, heavy.prior)
    with pytest.raises(InputError, match="prior has 6 joints"):
        cone_of(("joint_compliance.j7",), heavy.prior)
    with pytest.raises(InputError, match="matrix of shape"):
        Identified(both, ("a",), np.ones((1, 3)), np.ones(1))


def test_everything_held_at_constants_is_judged_too(heavy):
    truth = heavy.cone.scale * heavy.cone.prior
    identified = identified_from(heavy, truth)
    every = dict(zip(heavy.cone.names, truth.tolist(), strict=True))
    found = reconstruct(identified, heavy.prior, fixed=every)
    np.testing.assert_allclose(found.upper - found.lower, 0, atol=1e-9)
    with pytest.raises(Infeasible, match="constants break positive definiteness: no matrix of joints"):
        reconstruct(identified, heavy.prior, fixed={**every, "joint_compliance.j3": -1.0})


def test_springs_of_joints_foot_and_tool_have_their_blocks():
    names = ("joint_compliance.j1", "joint_compliance.j2", "joint_cross_compliance.j1-j2", "joint_compliance.j3",
             "joint_cross_compliance.j3-j4", "base_compliance.column.rx", "tool_compliance.flange.z",
             "geometry.j1.offset", "link_compliance.link1.k26")  # fmt: skip
    prior = beam_prior(kr270())
    cone = cone_of(names, prior)
    assert [(block.label, block.columns.tolist()) for block in cone.blocks] == [
        ("joints", [[0, 2], [2, 1]]), ("joints", [[3]]), ("base_compliance.column", [[5]]),
        ("tool_compliance.flange", [[6]]),
    ]  # fmt: skip
    sizes = [prior.joints[0], prior.joints[1], np.sqrt(prior.joints[0] * prior.joints[1]), prior.joints[2]]
    np.testing.assert_allclose(cone.scale[:4], np.array(sizes) * 1e6)
    np.testing.assert_allclose(cone.scale[5:8], [prior.links[0, 3, 3] * 1e6, prior.links[6, 2, 2] * 1e6, 1.0])


# ---- the constrained fit


def measured(case, truth, sigma, *, poses=15, seed=0, options=None, free=False):
    """A fit of the beam model of all links to simulated readings at 2.5 kN."""
    rng = np.random.default_rng(seed)
    loads = (LOADS[0], replace(LOADS[1], force=np.array([0.0, 0.0, -FORCE])))
    study = replace(case.study, loads=loads, noise=Noise(reading=sigma), frame_free=free, markers_fitted=free)
    study = replace(study, effects=("joint_compliance", "link_compliance"))
    true, known = model_of(study), dict(zip(case.cone.names, truth, strict=True))
    values = np.array([known.get(name, 0.0) for name in true.names])
    q = random_configurations(study, poses, rng)
    experiment = full_experiment(q, np.tile([0, 1], (poses, 1)), study.loads, study.markers)
    data = simulate(true, values, experiment, study.noise, np.eye(4), rng)
    return identify(replace(study, **(options or {})), data)


def chi2_at(result, names, values):
    """Sum of squares of the whitened residual with other parameters."""
    own = dict(zip(names, values, strict=True))
    everything = np.array([own.get(name, 0.0) for name in result.model.names])
    position = respond(result.model, result.data.experiment, everything, derivative=False).position
    white = result.fit.whitening.apply(result.data.positions - position)
    return float(white @ white)


def test_a_noisy_fit_is_made_positive_at_the_least_cost(heavy):
    truth = heavy.cone.scale * heavy.cone.prior
    result = measured(heavy, truth, 1.2e-4)
    with pytest.raises(Infeasible, match="std"):
        reconstruct(identified_by_fit(result), heavy.prior)
    found = identify_positive(result, heavy.prior)
    names = found.identified.full
    assert found.chi2_increase > 0
    assert found.worst
    assert (found.identified.matrix @ found.values) == pytest.approx(found.identified.values)
    assert chi2_at(result, names, found.values) - result.fit.chi2 == pytest.approx(found.chi2_increase, rel=1e-5)
    assert chi2_at(result, names, truth_of(heavy, truth, names)) > chi2_at(result, names, found.values)
    full = reconstruct(found.identified, heavy.prior)
    positive_definite(full)
    assert np.isfinite([full.lower, full.upper]).all()
    for step in (0.1, 0.01):  # towards the truth, which is possible too
        between = found.values + step * (truth_of(heavy, truth, names) - found.values)
        assert chi2_at(result, names, between) > chi2_at(result, names, found.values) - 1e-6


def truth_of(case, truth, names):
    known = dict(zip(case.cone.names, truth, strict=True))
    return np.array([known[name] for name in names])


def test_the_constraint_brings_a_noisy_fit_closer_to_the_truth(heavy):
    truth = heavy.cone.scale * heavy.cone.prior
    before, after = [], []
    for seed in range(6):
        result = measured(heavy, truth, 1.2e-4, seed=seed)
        found = identify_positive(result, heavy.prior)
        exact = found.identified.matrix @ truth_of(heavy, truth, found.identified.full)
        std = np.sqrt(np.diag(found.identified.covariance))
        before.append(np.sum(((found.unconstrained - exact) / std) ** 2))
        after.append(np.sum(((found.identified.values - exact) / std) ** 2))
    assert np.mean(after) < np.mean(before)


def test_a_fit_that_is_positive_already_stays(heavy):
    truth = heavy.cone.scale * heavy.cone.prior
    result = measured(heavy, truth, 1e-8, poses=40)
    found = identify_positive(result, heavy.prior)
    assert found.chi2_increase == 0
    assert not found.worst
    np.testing.assert_array_equal(found.identified.values, identified_by_fit(result).values)


def test_the_irreducible_model_is_constrained_through_its_reduction(heavy):
    """26 fitted parameters, matrices of the 62 behind them: the same optimum as with all of them in the model."""
    truth = heavy.cone.scale * heavy.cone.prior
    tables = reduced_model(heavy.study, heavy.reduction)
    options = {"effects": tuple(tables["effects"]), "options": {"link_compliance": tables["link_compliance"]}}
    lean = measured(heavy, truth, 1.2e-4, options=options)
    assert len(lean.kept) == 26
    found = identify_positive(lean, heavy.prior, reduction=heavy.reduction)
    whole = identify_positive(measured(heavy, truth, 1.2e-4), heavy.prior)
    assert found.chi2_increase == pytest.approx(whole.chi2_increase, rel=1e-3)
    full = reconstruct(found.identified, heavy.prior, intervals=())
    positive_definite(full)
    assert set(full.parameters) == set(heavy.cone.names)


def test_constants_of_a_model_that_break_positive_definiteness_are_refused(heavy):
    truth = heavy.cone.scale * heavy.cone.prior
    broken = {"template": "beam", "link2": {"template": ["k11", "k33", "k44", "k55", "k35"]},
              "constants": {"link2.k22": 0.001, "link2.k66": 0.001, "link2.k26": 0.5}}  # fmt: skip
    result = measured(heavy, truth, 1e-6, poses=40, options={"options": {"link_compliance": broken}})
    with pytest.raises(Infeasible, match="link2"):
        identify_positive(result, heavy.prior)
