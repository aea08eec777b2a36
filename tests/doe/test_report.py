"""The report: one file that needs nothing else, says the verdict first and trusts no text."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from doe.cli import run
from doe.report.words import CAUSES, heading, length, number, probability
from identify.csv_file import csv_text
from identify.effects import REGISTRY
from identify.results import json_text
from tests.doe.diagnosed import arm_study, measured_arm

HOSTILE = "<script>alert('x')</script><img src=http://evil.example/x onerror=alert(1)>\"'&"
VOID = {"meta", "link", "br", "img", "input", "hr"}


def parameter(**changes):
    """A fitted size."""
    return {
        "name": "geometry.j3.a", "value": 0.4, "unit": "mm", "std": 0.05, "ci95": [0.3, 0.5], "typical": 0.5,
        "plausible_up_to": 5.0, "plausible": True, "nuisance": False, **changes,
    }  # fmt: skip


def cause(**changes):
    """A cause."""
    return {
        "name": "geometry", "where": "j3", "p_value": 1e-9, "ambiguous_with": [], "parameters": [parameter()],
        "options": {}, **changes,
    }  # fmt: skip


GAIN = {
    "heldout_rms_before_mm": 0.3, "heldout_rms_after_mm": 0.07, "noise_rms_mm": 0.06, "poses_heldout": 30,
    "ci95": [0.2, 0.27], "significant": True,
}  # fmt: skip


def diagnosis(**changes):
    """The content of a diagnose.json."""
    lack = {"chi2": 4000.0, "dof": 1000, "p_value": 0.0}
    return {
        "verdict": "cause_found",
        "causes": [cause()],
        "remainder": False,
        "remainder_depends_on": None,
        "gain": GAIN,
        "noise": {"stated_mm": 0.03, "found_mm": 0.0305, "reading_times_stated": 1.02},
        "extended_model": ["joint_compliance", "geometry@j3"],
        "wrong": {
            "rms_mm": 0.31,
            "max_mm": 0.9,
            "axis_rms_mm": {"x": 0.1, "y": 0.2, "z": 0.2},
            "marker_rms_mm": {"M1": 0.3},
            "load_rms_mm": {"L0": 0.3, "L1": 0.31},
            "worst_poses": [{"pose": "P7", "rms_mm": 0.5}],
            "depends_on": [{"column": "q3_deg", "axis": "z", "correlation": -0.7, "p_value": 1e-12}],
            "replicates": None,
        },
        "lack_of_fit": {"before": lack, "after": {"chi2": 1010.0, "dof": 996, "p_value": 0.4}},
        "significance": "holm",
        "reference": "absolute",
        "identification": {
            "parameters": [parameter(), parameter(name="frame.x", nuisance=True)],
            "covariance_kind": "stated noise",
            "reference": "absolute",
            "nonidentifiable": [],
        },
        "notes": [],
        "extended_study": "extended.toml",
        "next_poses": None,
        "provenance": {"versions": {"elastocal": "0.1"}, "seed": 0, "inputs": {"study.toml": "ab" * 32}},
        **changes,
    }


def residuals(rows=60, **changes):
    """The text of a residuals.csv of random residuals, three markers a reading."""
    rng = np.random.default_rng(1)
    which = np.arange(rows)
    names = ["x", "y", "z", "before_x", "before_y", "before_z", "after_x", "after_y", "after_z"]
    columns = {
        "pose": [f"P{i // 6}" for i in which],
        "load": [f"L{i // 3 % 2}" for i in which],
        "marker": [f"M{i % 3}" for i in which],
        "repeat": np.ones(rows, dtype=int),
        "line": which + 2,
        **{f"{name}_mm": rng.normal(0, 1, rows) for name in names},
        "faulty": np.zeros(rows, dtype=int),
        **{f"q{joint}_deg": np.repeat(rng.uniform(-90, 90, rows // 6), 6) for joint in range(1, 7)},
        **{f"t{joint}_Nm": rng.uniform(-900, 900, rows) for joint in range(1, 7)},
        "time_s": which * 10.0,
        "temperature_C": 20 + which / rows,
        "range_m": rng.uniform(2, 5, rows),
        **changes,
    }
    return csv_text(list(columns), list(columns.values()))


@pytest.fixture
def made(tmp_path):
    """Write a diagnosis (and files beside it), make the report, and return its text."""

    def make(content, **files):
        (tmp_path / "diagnose.json").write_text(json_text(content))
        for name, text in files.items():
            (tmp_path / name.replace("_csv", ".csv")).write_text(text)
        assert run(["report", str(tmp_path)]) == 0
        return (tmp_path / "report.html").read_text(encoding="utf-8")

    return make


class Reader(HTMLParser):
    """Elements in order, their balance, and the text without markup."""

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.links, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.links += [value for name, value in attrs if name in {"href", "src", "xlink:href", "action", "data"}]
        self.links += [name for name, _ in attrs if name.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_it_needs_nothing_from_outside(made):
    text = made(diagnosis(), residuals_csv=residuals())
    page = Reader(text)
    assert page.open == []
    assert not page.links
    assert not {"script", "link", "iframe", "object", "img"} & set(page.seen)
    assert not re.search(r"https?://|//[a-z]+\.|@import|url\(", text)
    assert page.seen.count("svg") > 10


@pytest.mark.parametrize(
    ("verdict", "changes", "sentence"),
    [
        ("adequate", {"causes": [], "gain": None}, "Nothing significant is missing"),
        ("cause_found", {}, "explained by an error of the geometry at joint 3."),
        (
            "ambiguous",
            {"causes": [cause(ambiguous_with=["tracker_scale", "transmission_error@j2"])]},
            "but as well by a scale error of the instrument or an error of the gear over its turn at joint 2.",
        ),
        (
            "unexplained",
            {"causes": [], "gain": None, "remainder": True, "remainder_depends_on": "q3_deg"},
            "no name here. A significant misfit remains; it depends on joint 3 (deg).",
        ),
    ],
)
def test_the_verdict_stands_on_top_in_a_sentence(made, verdict, changes, sentence):
    text = made(diagnosis(verdict=verdict, **changes))
    top, rest = text.split("<h1>")[1].split("</h1>")
    assert sentence in top
    assert f'class="verdict {verdict}"' in text
    assert "<h2>" not in text[: text.index("<h1>")]
    assert re.findall(r"<h2>(\d)", rest) == ["2", "3", "4", "5", "6"]


def test_noise_that_is_misstated_is_said_in_the_verdict(made):
    noise = {"stated_mm": 0.03, "found_mm": 0.06, "reading_times_stated": 2.0}
    text = made(diagnosis(verdict="adequate", causes=[], gain=None, noise=noise))
    assert "The noise of a reading is 0.06 mm, not 0.03 mm as stated." in text.split("</h1>")[0]


def test_faulty_rows_alone_leave_the_simulation_right(made):
    fault = cause(name="data_fault", where="P6/M1", parameters=[], what="swapped", error_mm=306.0, lines=[8, 9])
    text = made(diagnosis(causes=[fault]))
    assert "The simulation is right, but the measurements hold faulty rows at pose P6, marker M1." in text
    assert "Lines 8, 9 of the measurements" in text
    assert "Correct the faulty rows" in text


def test_a_size_beyond_what_is_plausible_is_said(made):
    wild = parameter(name="transmission_error.j3.s1", value=5.0, unit="mrad", plausible_up_to=0.35, plausible=False)
    text = made(diagnosis(causes=[cause(name="transmission_error", parameters=[wild])]))
    assert "an error of the gear over its turn of 5 mrad is not plausible: at most 0.35 mrad" in text


def test_a_curve_is_drawn_for_what_depends_on_one_joint(made):
    curve = {"cause": "geometry@j3", "joint": "j3", "q_deg": [-10.0, 0.0, 10.0], "turn_mrad": [0.1, 0.0, 0.2],
             "half_mrad": [0.02, 0.01, 0.02]}  # fmt: skip
    assert "turn of joint 3 (mrad)" in made(diagnosis(curves=[curve]))
    assert "turn of joint 3 (mrad)" not in made(diagnosis(curves=[]))


def test_replicates_are_shown_where_there_are_some(made):
    plain = diagnosis()
    assert "No reading was repeated" in made(plain)
    ratio = {"before": {"ratio": 7.5, "p_value": 1e-20}, "after": {"ratio": 1.02, "p_value": 0.4}}
    text = made(
        diagnosis(wrong={**plain["wrong"], "replicates": {"readings": 90, "std_mm": 0.031, "dof": 120, **ratio}})
    )
    assert "90 readings have replicates (120 degrees of freedom)" in text
    assert "7.50" in text


def test_the_poses_to_measure_next_are_a_table(made):
    text = made(diagnosis(next_poses="next.csv"), next_csv="pose,load,q1_deg\nN1,L1,12.5\n")
    assert "would separate what is ambiguous" in text
    assert "12.5" in text.split("What to measure next")[1]


def test_a_plan_outside_the_folder_is_not_read(made, tmp_path):
    secret = tmp_path.parent / "secret.csv"
    secret.write_text("pose,load\nhidden,L1\n")
    assert "hidden" not in made(diagnosis(next_poses=f"../{secret.name}"))
    assert "hidden" not in made(diagnosis(next_poses=str(secret)))


def spoiled(value):
    """The same with hostile text in place of every text, and in the names of every id."""
    if isinstance(value, dict):
        ids = {"M1", "L0", "study.toml", "elastocal"}
        return {HOSTILE if key in ids else key: spoiled(item) for key, item in value.items()}
    if isinstance(value, list):
        return [spoiled(item) for item in value]
    return HOSTILE if isinstance(value, str) else value


def test_text_from_files_never_becomes_markup(made):
    names = {"pose": [HOSTILE.replace(",", "").replace('"', "")] * 60, "marker": ["<u>M</u>"] * 60}
    content = spoiled(diagnosis(notes=["a note"], measured={"robot": "r", "poses": 3, "readings": 4}))
    content["causes"] += spoiled([cause(what="w", error_mm=1.0, lines=["1"]), cause(ambiguous_with=["a", "b@c"])])
    table = residuals(**names, **{"<u>col</u>": np.arange(60.0)})
    page = Reader(made(content, residuals_csv=table))
    assert page.open == []
    assert not page.links
    assert not {"script", "img", "u"} & set(page.seen)
    assert "<u>col</u>" in page.words
    assert any(HOSTILE in words for words in page.words)


def test_twelve_thousand_rows_stay_below_two_megabytes(made):
    assert 1e5 < len(made(diagnosis(), residuals_csv=residuals(12_000)).encode()) < 2e6


def test_the_same_results_give_the_same_bytes(made):
    first = made(diagnosis(), residuals_csv=residuals())
    assert made(diagnosis(), residuals_csv=residuals()) == first


def test_faulty_rows_are_in_no_picture(made):
    far = np.zeros(60)
    far[7] = 5e4
    kept = made(diagnosis(), residuals_csv=residuals(before_x_mm=far, faulty=(far > 0).astype(int)))
    assert "5e+04" not in kept
    assert re.search(r"[45]0000", kept) is None


def test_other_files_stay_and_other_results_are_shown(made, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    criterion = {"name": "test_pose", "value": 3.2e-5, "unit": "mm^2", "rms_mm": 0.0057, "rms_total_mm": 0.0395}
    plan = {
        "criterion": criterion, "poses": 15, "different_poses": 7, "rank": 5, "reference": "differences",
        "bound": 3.2e-5, "efficiency": 0.994, "nonidentifiable": ["joint_compliance.j1"],
        "provenance": diagnosis()["provenance"],
    }  # fmt: skip
    (tmp_path / "plan.json").write_text(json_text(plan))
    text = made(diagnosis())
    assert "The plan" in text
    assert "0.0057 mm" in text
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert {p.name for p in tmp_path.iterdir()} == {
        "mine.txt",
        "plan.json",
        "diagnose.json",
        "report.html",
        "report.json",
    }
    assert json.loads((tmp_path / "report.json").read_text())["results"] == ["plan", "diagnose"]


def refused(capsys, *arguments):
    """The message of a refused report."""
    assert run(["report", *map(str, arguments)]) == 2
    return capsys.readouterr().err


def test_a_folder_without_results_is_refused(tmp_path, capsys):
    assert "does not exist" in refused(capsys, tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()
    (tmp_path / "notes.json").write_text("{}")
    assert "diagnose.json" in refused(capsys, tmp_path)
    assert "a folder" in refused(capsys, tmp_path / "notes.json")
    assert [p.name for p in tmp_path.iterdir()] == ["notes.json"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"schema": 2}', "schema 2 found"),
        ("[]", "schema None found"),
        ("{", "no JSON"),
        ('{"schema": 1}', "no key"),
        (json.dumps({"schema": 1, **diagnosis(lack_of_fit=3)}), "lack_of_fit: a table expected"),
        (json.dumps({"schema": 1, **diagnosis(gain={**GAIN, "noise_rms_mm": "x"})}), "noise_rms_mm: a number expected"),
    ],
)
def test_a_malformed_result_is_refused(tmp_path, capsys, text, said):
    (tmp_path / "diagnose.json").write_text(text)
    message = refused(capsys, tmp_path)
    assert said in message
    assert "diagnose.json" in message
    assert not (tmp_path / "report.html").exists()


def test_a_table_that_is_none_is_refused(tmp_path, capsys):
    (tmp_path / "diagnose.json").write_text(json_text(diagnosis()))
    (tmp_path / "residuals.csv").write_text("pose,load\nP1,L1\n")
    assert "missing columns" in refused(capsys, tmp_path)


def test_a_report_of_another_origin_is_kept(made, tmp_path, capsys):
    (tmp_path / "report.html").write_text("<h1>mine</h1>")
    (tmp_path / "diagnose.json").write_text(json_text(diagnosis()))
    assert "--force" in refused(capsys, tmp_path)
    assert (tmp_path / "report.html").read_text() == "<h1>mine</h1>"
    assert run(["report", str(tmp_path), "--force"]) == 0
    assert "elastocal report" in made(diagnosis())


def test_the_folder_is_named_as_it_was_given(tmp_path, capsys, monkeypatch):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "diagnose.json").write_text(json_text(diagnosis()))
    (tmp_path / "link").symlink_to(tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    for given, said in (("out", "out"), ("link", f"{tmp_path.resolve()}/out")):
        assert run(["report", given]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"written to {said}/report.json"


def test_json_alone_stands_on_stdout(tmp_path, capsys):
    (tmp_path / "diagnose.json").write_text(json_text(diagnosis()))
    assert run(["report", str(tmp_path), "--json", "--quiet"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["schema"] == 1
    assert content["report"] == "report.html"
    assert content["bytes"] == (tmp_path / "report.html").stat().st_size
    assert set(content["provenance"]["inputs"]) == {"diagnose.json"}


def test_every_effect_has_words():
    assert set(REGISTRY) <= set(CAUSES)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (number(0.123456), "0.123"),
        (number(-1234567.0), "−1234567"),
        (number(None), "–"),
        (number(float("nan")), "–"),
        (number(1234.5), "1234"),
        (length(0.3), "0.300"),
        (length(12.0), "12.0"),
        (length(306.0), "306"),
        (probability(0.0), "p < 1e−300"),
        (probability(0.0234), "p = 0.023"),
        (heading("t2_Nm"), "torque on joint 2 (Nm)"),
        (heading("unknown"), "unknown"),
    ],
)
def test_numbers_read_well(said, words):
    assert said == words


def test_a_real_diagnosis_becomes_a_report(tmp_path):
    study, measurements = arm_study(tmp_path), measured_arm(tmp_path, {"geometry.j3.offset": 0.6})
    assert run(["diagnose", str(study), str(measurements), "--out", str(tmp_path / "out")]) == 0
    assert run(["report", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    page = Reader(text)
    assert page.open == []
    assert "an error of the geometry at joint 3" in text.split("</h1>")[0]
    assert "residual against torque on joint 2 (Nm)" in text
    assert "residual vectors over the workspace" in text
    table = (tmp_path / "out" / "residuals.csv").read_text().splitlines()
    assert len(table) == len(measurements.read_text().splitlines())


def test_every_result_of_a_folder_has_its_section(tmp_path):
    study, measurements = arm_study(tmp_path), measured_arm(tmp_path, {}, poses=12)
    plan, out = tmp_path / "plan.csv", tmp_path / "out"
    for command in (
        ["identify", study, measurements],
        ["predict", study, out / "identify.json", plan],
        ["reduce", study],
    ):
        assert run([*map(str, command), "--out", str(out), "--force"]) == 0
    assert run(["report", str(out)]) == 0
    text = (out / "report.html").read_text(encoding="utf-8")
    assert Reader(text).open == []
    for words in ("The identification", "joint_compliance.j2", "The prediction", "72 readings predicted", "Rank"):
        assert words in text
    assert re.findall("<h2>(The [a-z ]+)</h2>", text) == [
        "The identification", "The prediction", "The reduction of the model"
    ]  # fmt: skip


# --- a plan and compensated targets


def plan_content(**changes):
    """The content of a plan.json with everything that a report shows."""
    drift = {"unit": "mm", "per_mm_h": 0.0058, "per_mrad_h": 0.018}
    order = {
        "visits": 2, "lifts": 3, "lifts_fewest": 2, "lifts_proven": True, "travel_deg": 40.5, "travel_s": 4.0,
        "detours": 1, "blocked": [], "drift_leftover": drift,
        "as_found": {"lifts": 4, "drift_leftover": {**drift, "per_mm_h": 0.077}},
    }  # fmt: skip
    point = {"bound_mm": 0.02, "plan_mm": 0.021, "random_mm": 0.05}
    return {
        "criterion": {"name": "test_pose", "value": 3.2e-5, "unit": "mm^2", "rms_mm": 0.0057, "rms_total_mm": 0.0395},
        "poses": 2, "different_poses": 2, "rank": 5, "reference": "differences", "bound": 3.1e-5, "efficiency": 0.9701,
        "efficiency_continuous": 0.9402, "efficiencies": {"A": 0.7103, "E": None}, "nonidentifiable": [],
        "measured": {"visits": 6, "rms_mm": 0.009}, "time_s": 8100.0, "order": order, "candidates": 321,
        "rejected": {"floor": 12, "walls": 0, "boxes": 345}, "notes": ["mind the gap"],
        "curve": [{"poses": 1, **point}, {"poses": 2, **point}], "provenance": diagnosis()["provenance"], **changes,
    }  # fmt: skip


VISITS = "pose,load,q1_deg,time_s\nP007,L0,12.345678,60.0\nP007,W1,12.345678,90.0\nP008,W1,-3.000000,150.0\n"


def reported(folder, **files):
    """The report of a folder with these files: JSON as content, tables as text."""
    for name, content in files.items():
        text = content if isinstance(content, str) else json_text(content)
        (folder / f"{name}.{'csv' if isinstance(content, str) else 'json'}").write_text(text)
    assert run(["report", str(folder)]) == 0
    return (folder / "report.html").read_text(encoding="utf-8")


def cells(text):
    """The texts of the rows of all tables, a tuple a row."""
    rows = re.findall(r"<tr>(.*?)</tr>", text, flags=re.S)
    return [tuple(re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", row)) for row in rows]


def test_a_plan_is_shown_with_order_times_curve_efficiencies_and_refused_candidates(tmp_path):
    (tmp_path / "plan.csv").write_text(VISITS)
    text = reported(tmp_path, plan=plan_content())
    rows = cells(text)
    assert ("efficiency on the candidates and these poses, proven", "97.01 %") in rows
    assert ("efficiency over all joint angles, estimated", "94.02 %") in rows
    assert ("efficiency by each criterion", "A 71.03 %") in rows
    assert ("beside what was measured", "6 visits, 0.009 mm rms alone") in rows
    assert ("time to measure it", "2 h 15 min") in rows
    assert ("crane operations (proven fewest: 2)", "3", "4") in rows
    assert ("error that a drift of 1 mm/h leaves, mm", "0.0058", "0.077") in rows
    assert rows.index(("boxes", "345")) < rows.index(("floor", "12")), "most frequent first"
    assert "walls" not in text
    visits = [row for row in rows if row and row[0].startswith("P0")]
    assert visits == [("P007", "L0, W1", "12.35", "60.00"), ("P008", "W1", "-3.00", "150.00")]
    assert "<svg" in text
    assert "mind the gap" in text
    assert set(json.loads((tmp_path / "report.json").read_text())["provenance"]["inputs"]) == {"plan.json", "plan.csv"}


def test_a_plan_of_two_arms_has_an_order_for_each(tmp_path):
    own = plan_content()["order"]
    (tmp_path / "plan_R1.csv").write_text(VISITS)
    text = reported(tmp_path, plan=plan_content(arms={"R1": 2, "R2": 0, "../x": 1}, order={"R1": own, "R2": None}))
    assert "Order of measuring, R1" in text
    assert "Order of measuring, R2" not in text
    assert "plan_R1.csv, in the order of measuring" in text


def test_a_plan_without_visits_needs_no_rows(tmp_path):
    (tmp_path / "plan.csv").write_text("pose,load,q1_deg\n")
    text = reported(tmp_path, plan=plan_content(poses=0, order=None, curve=[]))
    assert "in the order of measuring" not in text


def compensation(targets, **changes):
    """The content of a compensate.json."""
    return {
        "targets": targets, "form": "joint", "passes": 3, "deflection": {"rms_mm": 2.57, "max_mm": 3.19},
        "residual": {"rms_mm": 0.004, "max_mm": 0.012}, "residual_ci95": {"rms_mm": 0.0059, "max_mm": 0.0065},
        "extrapolated": ["T2"], "notes": ["the sag stays"], "provenance": diagnosis()["provenance"], **changes,
    }  # fmt: skip


def targets_csv(rows):
    """The text of a compensated.csv; its other columns are of no interest here."""
    lines = [",".join(map(str, row)) for row in rows]
    return "\n".join(["target,residual_mm,residual_ci95_mm,deflection_mm,extrapolated", *lines]) + "\n"


def test_what_compensation_changed_is_told_target_by_target(tmp_path):
    table = targets_csv([("T1", 0.0, 0.0053, 2.4031, 0), ("T2", 0.0124, 0.0065, 3.1892, 1)])
    text = reported(tmp_path, compensate=compensation(2), compensated=table)
    rows = cells(text)
    assert ("predicted error before", "2.57 mm", "3.19 mm") in rows
    assert ("predicted error after, by the model", "0.004 mm", "0.012 mm") in rows
    assert ("T1", "2.40", "0", "0.00530", "") in rows
    assert ("T2", "3.19", "0.0124", "0.00650", "extrapolated") in rows
    assert "extrapolated: T2." in text
    assert "the sag stays" in text
    assert Reader(text).open == []


def test_of_many_targets_those_are_listed_of_which_most_remains(tmp_path):
    table = targets_csv([(f"T{i}", i / 1000, 0.001, 2.0, 0) for i in range(200)])
    rows = cells(reported(tmp_path, compensate=compensation(200, extrapolated=[]), compensated=table))
    assert [row[0] for row in rows if row and row[0].startswith("T")] == [f"T{i}" for i in range(140, 200)]


def test_text_of_plans_and_targets_never_becomes_markup(tmp_path):
    bad = HOSTILE.replace(",", "").replace('"', "")
    (tmp_path / "plan.csv").write_text(VISITS.replace("P007", bad).replace("time_s", bad))
    table = targets_csv([(bad, 0.0, 0.1, 2.0, 1)])
    content = spoiled(plan_content(rejected={HOSTILE: 3}, efficiencies={HOSTILE: 0.5}))
    text = reported(tmp_path, plan=content, compensate=spoiled(compensation(1)), compensated=table)
    page = Reader(text)
    assert page.open == []
    assert not page.links
    assert not {"script", "img"} & set(page.seen)
    assert bad in page.words


@pytest.mark.parametrize(
    ("name", "table", "said"),
    [
        ("compensated", "target,residual_mm\nT1,0.1\n", "missing columns"),
        ("compensated", targets_csv([("T1", "x", 0.1, 2.0, 0)]), "residual_mm"),
        ("plan", "pose,q1_deg\nP1,3\n", "missing column load"),
    ],
)
def test_a_malformed_table_of_a_plan_or_of_targets_is_refused(tmp_path, capsys, name, table, said):
    (tmp_path / "plan.json").write_text(json_text(plan_content()))
    (tmp_path / "compensate.json").write_text(json_text(compensation(1)))
    (tmp_path / f"{name}.csv").write_text(table)
    message = refused(capsys, tmp_path)
    assert said in message
    assert f"{name}.csv" in message


def test_help_of_the_command(capsys):
    assert run(["report", "--help"]) == 0
    shown = capsys.readouterr().out
    assert all(option in shown for option in ("FOLDER", "--json", "--quiet", "--force"))
