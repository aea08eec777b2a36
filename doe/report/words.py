"""Names of causes and places, numbers and probabilities, as a person would say them."""

from __future__ import annotations

import math
import re
from typing import Any

from doe.report.folder import Entry

__all__ = [
    "CAUSES",
    "cause_words",
    "gain_words",
    "heading",
    "length",
    "number",
    "place_words",
    "probability",
    "size_words",
    "verdict_words",
]

#: Name of a cause -> what it is.
CAUSES = {
    "approach_hysteresis": "hysteresis of the approach",
    "backlash": "backlash",
    "base_compliance": "a foundation that yields",
    "data_fault": "faulty rows",
    "force_sensor_bias": "a bias of the force sensor",
    "geometry": "an error of the geometry",
    "gravity_compensator": "a gravity compensator",
    "joint_compliance": "the compliance",
    "joint_cross_compliance": "joints that yield together",
    "joint_hardening": "a joint that gets stiffer under load",
    "joint_windup": "wind-up of the gear around zero torque",
    "link_compliance": "a link that bends",
    "link_mass": "a wrong mass",
    "load_com": "a weight that hangs elsewhere than stated",
    "load_direction": "gravity in another direction than stated",
    "load_level": "a wrong weight",
    "load_scale": "a scale error of all loads",
    "marker_seating": "a shifted seat under load",
    "range_noise": "noise that grows with the distance to the instrument",
    "stiction": "friction that holds the joint back",
    "thermal_growth": "growth with temperature",
    "tool_compliance": "a tool that yields",
    "tracker_drift": "drift of the instrument",
    "tracker_scale": "a scale error of the instrument",
    "tracker_step": "a knock at the instrument",
    "transmission_error": "an error of the gear over its turn",
    "wrist_coupling": "coupling of the wrist axes",
}

_LABELS = {
    "adequate": "adequate",
    "cause_found": "cause found",
    "ambiguous": "ambiguous",
    "unexplained": "unexplained",
}
_BEFORE = {
    "data_fault": "at pose ",
    "joint_compliance": "of ",
    "link_mass": "of ",
    "load_level": "of load ",
    "marker_seating": "of marker ",
}
_MISSTATED = 1.25  # times the stated noise, or less than the inverse
_QUANTITIES = (
    (re.compile(r"q(\d+)_(deg|mm)"), r"joint \1 (\2)"),
    (re.compile(r"t(\d+)_(Nm|N)"), r"torque on joint \1 (\2)"),
    (re.compile(r"approach(\d+)"), r"approach of joint \1"),
    (re.compile(r"time_s"), "time (s)"),
    (re.compile(r"temperature_C"), "temperature (°C)"),
    (re.compile(r"range_m"), "distance to the instrument (m)"),
)
_PLACES = (
    (re.compile(r"j(\d+)-j(\d+)"), r"joints \1 and \2"),
    (re.compile(r"j(\d+)"), r"joint \1"),
    (re.compile(r"link(\d+)"), r"link \1"),
    (re.compile(r"base|column|flange"), r"the \g<0>"),
)


def number(value: Any, digits: int = 3) -> str:
    """A number with some significant digits; a dash for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "–" if value is None or isinstance(value, float) else str(value)
    text = f"{value:.{digits}g}"
    if "e" in text and 1e-4 <= abs(value) < 1e7:
        text = f"{value:.0f}"
    return text.replace("-", "−")


def length(value: Any) -> str:
    """A measured length or ratio with three digits, trailing zeros kept."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 1e-4 <= abs(value) < 1e3:
        return number(value)
    return f"{value:#.3g}".rstrip(".").replace("-", "−")


def millimetres(value: Any) -> str:
    """A length with its unit; a dash for what is none."""
    return "–" if value is None else f"{number(value)} mm"


def probability(value: Any) -> str:
    """A probability: ``p = 0.02``, or a bound where it is too small to tell."""
    if not isinstance(value, int | float):
        return ""
    return "p < 1e−300" if value < 1e-300 else f"p = {number(value, 2)}"


def heading(column: str) -> str:
    """The name of a column of the table in words."""
    return next((at.sub(words, column) for at, words in _QUANTITIES if at.fullmatch(column)), column)


def place_words(where: Any, before: str = "at ") -> str:
    """`` at joint 5``, or with another word before it; empty for no place."""
    if where is None:
        return ""
    place = str(where)
    for pattern, words in _PLACES:
        if pattern.fullmatch(place):
            return f" {before}{pattern.sub(words, place)}"
    pose, _, marker = place.partition("/")
    return f" {before}{pose}, marker {marker}" if marker else f" {before}{place}"


def cause_words(name: Any, where: Any) -> str:
    """A cause with its place."""
    return CAUSES.get(str(name), str(name)) + place_words(where, _BEFORE.get(str(name), "at "))


def rival_words(entry: str) -> str:
    """A rival, ``name`` or ``name@where``, in words."""
    name, _, where = entry.partition("@")
    return cause_words(name, where or None)


def size_words(cause: Entry, parameter: Entry) -> str:
    """How a fitted size compares with what is usual and what is possible."""
    value, unit = parameter["value"], parameter["unit"]
    typical, most = parameter.get("typical"), parameter.get("plausible_up_to")
    if not parameter.get("plausible", True):
        what = CAUSES.get(cause["name"], cause["name"])
        return f"{what} of {number(value)} {unit} is not plausible: at most {number(most)} {unit}"
    if not isinstance(value, int | float) or not isinstance(typical, int | float) or typical <= 0:
        return "" if not isinstance(most, int | float) else f"plausible, at most {number(most)} {unit}"
    limit = f", plausible up to {number(most)} {unit}" if isinstance(most, int | float) else ""
    word = "no more than usual" if abs(value) <= 2 * typical else "more than usual"
    return f"{word} (typically {number(typical)} {unit}{limit})"


def verdict_label(verdict: str) -> str:
    """The verdict as a short label."""
    return _LABELS.get(verdict, verdict)


def verdict_words(diagnosis: Entry) -> str:
    """The verdict in one plain sentence, or two."""
    causes = diagnosis.tables("causes")
    named = _listed([cause_words(cause["name"], cause["where"]) for cause in causes])
    verdict = diagnosis["verdict"]
    if verdict == "adequate":
        said = "Nothing significant is missing: the simulation explains these measurements."
    elif verdict == "cause_found" and not _lacks(causes):
        said = f"The simulation is right, but the measurements hold {named}."
    elif verdict == "cause_found":
        said = f"What the simulation lacks is explained by {named}."
    elif verdict == "ambiguous":
        rivals = dict.fromkeys(rival_words(name) for cause in causes for name in cause.texts("ambiguous_with"))
        said = f"What the simulation lacks is explained by {named}, but as well by {_listed(list(rivals), 'or')}."
    elif causes:
        said = f"The simulation lacks something that has no name here; {named} {_is(causes)} less than half of it."
    else:
        said = "The simulation lacks something significant that has no name here."
    return " ".join(part for part in (said, _remainder_words(diagnosis), noise_words(diagnosis)) if part)


def _lacks(causes: list[Entry]) -> bool:
    """True if a cause is more than rows or scatter."""
    return any(cause["name"] not in {"data_fault", "range_noise"} for cause in causes)


def _is(causes: list[Entry]) -> str:
    return "is" if len(causes) == 1 else "are"


def _listed(words: list[str], last: str = "and") -> str:
    """Words in a row."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else "nothing"


def _remainder_words(diagnosis: Entry) -> str:
    """What is left after the extension."""
    if not diagnosis["remainder"]:
        return ""
    on = diagnosis["remainder_depends_on"]
    known = "has no known cause" if on is None else f"depends on {heading(str(on))}"
    return f"A significant misfit remains; it {known}."


def gain_words(gain: Entry | None) -> str:
    """What naming the causes gains."""
    if gain is None:
        return ""
    before, after, noise = (
        length(gain[f"{key}_mm"]) for key in ("heldout_rms_before", "heldout_rms_after", "noise_rms")
    )
    if not gain["significant"]:
        return f"On poses that took no part no gain can be claimed: {before} mm before, {after} mm after."
    return (
        f"With it in the model the error on poses that took no part falls from {before} mm to {after} mm; the noise "
        f"alone would leave {noise} mm."
    )


def noise_words(diagnosis: Entry) -> str:
    """Noise that is not as stated; empty if it is."""
    noise = diagnosis.table("noise")
    times, stated, found = noise.get("reading_times_stated"), noise["stated_mm"], noise["found_mm"]
    if not isinstance(times, int | float) or 1 / _MISSTATED <= times <= _MISSTATED:
        return ""
    if stated is None or found is None:
        return f"The noise of a reading is {number(times, 2)} times the stated one."
    return f"The noise of a reading is {number(found)} mm, not {number(stated)} mm as stated."
