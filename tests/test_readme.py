"""What the README shows is what comes out; what it points to exists."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from decimal import Decimal
from pathlib import Path
from types import ModuleType

import pytest

from identify.diagnosis import evidence, faults, gain, gates, replicate_noise, search, verdict
from identify.fit import OUTLYING

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
DECIMAL = re.compile(r"(?<![\w.])-?\d+(?:\.\d+(?:e[+-]?\d+)?|e[+-]?\d+)")


def script(name: str) -> ModuleType:
    """A script of the folder docs."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def tail(number: str) -> Decimal:
    """One unit in the last printed digit."""
    return Decimal((0, (1,), int(Decimal(number).as_tuple().exponent)))


def same_print(shown: str, made: str) -> bool:
    """Equal words and whole numbers; decimal numbers may differ by one in the last digit."""
    if DECIMAL.sub("#", shown).split() != DECIMAL.sub("#", made).split():
        return False
    pairs = zip(DECIMAL.findall(shown), DECIMAL.findall(made), strict=True)
    return all(abs(Decimal(a) - Decimal(b)) <= max(tail(a), tail(b)) for a, b in pairs)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[str, str]]]:
    """The folder where the demo ran, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, script("make_readme").run_demo(folder)


def test_one_digit_is_all_that_may_move() -> None:
    assert same_print("value  3.2247e-05 mm, 15 poses", "value 3.2248e-05 mm, 15 poses")
    assert not same_print("3.2247e-05", "3.2249e-05")
    assert not same_print("15 poses", "16 poses")
    assert same_print("rms 0.029", "rms 0.03")
    assert not same_print("rms 0.0719 mm", "rms 0.0719 um")


def test_readme_shows_what_the_demo_prints(demo: tuple[Path, list[tuple[str, str]]]) -> None:
    maker = script("make_readme")
    again = "renew the README with: .venv/bin/python docs/make_readme.py"
    sections = maker.demo_sections(demo[1])
    assert list(sections) == ["demo", "diagnosis"]
    for name, made in sections.items():
        _, shown, _ = maker.section_of(README, name)
        lines = zip(shown.splitlines(), made.splitlines(), strict=False)
        wrong = [f"shown: {old}\n made: {new}" for old, new in lines if not same_print(old, new)]
        assert not wrong, "\n".join([*wrong, again])
        assert len(shown.splitlines()) == len(made.splitlines()), again


@pytest.mark.slow
def test_readme_shows_the_plan_of_the_cell(tmp_path: Path) -> None:
    maker = script("make_readme")
    _, shown, _ = maker.section_of(README, "cell")
    made = maker.block(maker.run_demo(tmp_path / "cell", "cell"))
    assert same_print(shown, made), "renew the README with: .venv/bin/python docs/make_readme.py"
    assert "proven optimal" in shown


def test_python_snippets_of_the_readme_run(
    demo: tuple[Path, list[tuple[str, str]]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(demo[0])
    snippets = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert snippets
    for snippet in snippets:
        exec(compile(snippet, "README.md", "exec"), {})
    assert "joint_compliance.j2" in capsys.readouterr().out


def test_picture_of_the_readme_is_drawn_from_the_demo_and_small(demo: tuple[Path, list[tuple[str, str]]]) -> None:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        maker = script("make_demo_picture")
    finally:
        sys.path.remove(str(ROOT / "docs"))
    drawn = maker.svg(maker.picture(demo[0]))
    assert drawn == maker.svg(maker.picture(demo[0])), "the same numbers give the same bytes"
    committed = (ROOT / "docs" / "demo.svg").read_text(encoding="utf-8")
    names = re.compile(r"<!-- (.*?) -->")  # every text of the picture stands in a comment
    assert same_print(" ".join(names.findall(committed)), " ".join(names.findall(drawn))), (
        "renew the picture with: .venv/bin/python docs/make_demo_picture.py"
    )
    assert len(committed) < 300_000
    assert not re.search(r"(href|src)=\"http|<dc:date>", committed)


def test_every_key_of_a_diagnosis_is_documented(demo: tuple[Path, list[tuple[str, str]]]) -> None:
    told = json.loads((demo[0] / "out/demo/diagnose/diagnose.json").read_text(encoding="utf-8"))
    formats = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    section = formats[formats.index("**Diagnosis**") : formats.index("**Report**")]
    tables = [told, *(told[key] for key in ("measured", "gain", "noise", "wrong", "lack_of_fit"))]
    tables += [told["causes"][0], told["causes"][0]["parameters"][0], told["wrong"]["worst_poses"][0]]
    tables += [told["wrong"]["depends_on"][0], told["lack_of_fit"]["before"]]
    keys = {key for table in tables for key in table} - {"schema", "provenance"}
    assert len(keys) > 50
    assert not [key for key in sorted(keys) if not re.search(rf"`(\w+\.)?{key}`", section)]


def test_limits_of_a_diagnosis_are_those_of_the_code() -> None:
    theory = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
    section = " ".join(theory[theory.index("## Diagnosis") : theory.index("## What to measure next")].split())
    said = (
        f"less than {evidence._INVISIBLE:g} sigma at the largest plausible size",
        f"(by {search._SURE:g} sigma) more than {search._BEYOND:g} times what is plausible",
        f"after Holm's rule (1979) is below {100 * gates.LEVELS['holm']:g} %",
        f"at least {replicate_noise._LEAST} degrees of freedom",
        f"agrees with it at {100 * verdict._REJECTED:g} %",
        f"over {gates._FLIPS} random flips of whole visits, at {100 * gates._FLIP_LEVEL:g} %",
        f"take off {100 * search._WORTH:g} % of the left-out error",
        f"(the {search._SHORTLIST} most probable)",
        f"up to {search._MOST} causes",
        f"(Wald's test, p above {100 * search._STILL:g} %)",
        f"explains {100 * search._NEAR:g} % of what the cause does",
        f"significant at {100 * verdict._PATTERN:g} % among all of its kind",
        f"more than {verdict._TOO_WIDE:g} times its stated size",
        f"At {100 * verdict._RANGE:g} % `range_noise` is a cause",
        f"limits of {verdict._FIRST:g} and {verdict._LATER:g} robust sigmas",
        f"beyond {OUTLYING:g} robust scales",
        f"at least {faults._GAIN:g} times smaller, and at most {faults._MENDED:g} times that of usual visits",
        f"{gain._BOOTSTRAPS} resamplings",
        f"Above {gain._MANY} visits",
        f"Fewer than {verdict._LEAST_VISITS} poses",
    )
    assert not [words for words in said if words not in section]


def links(page: Path) -> set[str]:
    """Relative targets of links and pictures, and paths in code marks that look like files of this repository."""
    text = page.read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    named = re.findall(r"`((?:configs|docs|doe|identify|notebooks|tests|benchmarks|\.ci)/[\w./-]*)`", text)
    beside = {(page.parent / link).relative_to(ROOT).as_posix() for link in linked if "://" not in link}
    return beside | set(named)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_points_to_exists(page: Path) -> None:
    missing = sorted(link for link in links(page) if not (ROOT / link).exists())
    assert not missing


def test_marked_sections_stand_once() -> None:
    for name in ("demo", "diagnosis"):
        assert README.count(f"<!-- {name}:begin -->") == README.count(f"<!-- {name}:end -->") == 1
