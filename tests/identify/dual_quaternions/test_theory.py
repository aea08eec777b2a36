"""Limits that docs/theory.md states are those of the code."""

from pathlib import Path

from identify.dual_quaternions import algebra, correction, elastic

THEORY = Path(__file__).parents[3] / "docs" / "theory.md"


def power_of_ten(value):
    return f"{value:.0e}".replace("e-0", "e-")


def test_limits_of_dual_quaternions_are_those_of_the_code():
    text = THEORY.read_text(encoding="utf-8")
    section = " ".join(text[text.index("## Dual quaternions") :].split())
    for said in (
        f"both checked to {power_of_ten(algebra.UNIT_TOLERANCE)}",
        f"its smallest singular value is below {power_of_ten(elastic._RIGID)} of the largest",
        f"singular values below {power_of_ten(correction._SINGULAR)} of the largest left out",
    ):
        assert said in section, said
