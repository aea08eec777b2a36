"""What separates causes that no pose separates: one more thing to measure, by name or by pair of names."""

from __future__ import annotations

__all__ = ["remedy"]

_FLOOR = "read a target fixed on the floor at every pose"
_CURRENTS = "record the motor currents"
_WEIGH = "weigh the masses"
_BAR = "measure a scale bar"

_PAIRS: dict[frozenset[str], str] = {
    frozenset(pair): text
    for pair, text in (
        (
            ("transmission_error", "gravity_compensator"),
            f"{_CURRENTS} of the joint, or measure again with another pressure (or spring) of the compensator",
        ),
        (
            ("gravity_compensator", "link_mass"),
            f"{_CURRENTS} of the joint, or change the pressure (or spring) of the compensator",
        ),
        (("transmission_error", "link_mass"), f"{_CURRENTS}, or change the payload only at equal joint values"),
        (("tracker_scale", "geometry"), _BAR),
        (("thermal_growth", "geometry"), "come back to one pose every hour and log the temperature"),
        (("tracker_drift", "tracker_step"), _FLOOR),
        (("tracker_drift", "thermal_growth"), f"{_FLOOR}, and log the temperature of the arm"),
        (("tracker_drift", "load_direction"), f"{_FLOOR}, or level the base"),
        (("load_scale", "load_level"), f"{_WEIGH}, or hang a reference mass"),
        (("load_level", "stiction"), f"{_WEIGH}, and read each load while loading and while unloading"),
        (("joint_windup", "stiction"), "read each load while loading and while unloading"),
        (("joint_windup", "backlash"), "read a ladder of small loads through zero torque"),
        (
            ("joint_windup", "joint_hardening"),
            "read three or more load levels, small ones included, in both directions",
        ),
        (("marker_seating", "force_sensor_bias"), "exchange the reflectors, and read the unloaded force sensor"),
        (("marker_seating", "tool_compliance"), "put reflectors on both sides of the flange"),
        (("load_com", "force_sensor_bias"), "hang the same mass on two hooks, and read the unloaded force sensor"),
        (("load_com", "tool_compliance"), "hang the same mass on two hooks"),
        (("approach_hysteresis", "transmission_error"), "approach one pose from both sides"),
        (("base_compliance", "link_compliance"), "put a reflector on the base and one on the elbow"),
        (("link_compliance", "joint_cross_compliance"), "put a reflector on the elbow, or load with pure moments"),
        (("base_compliance", "load_direction"), "put a reflector on the base, or level it"),
    )
}

_SINGLE: dict[str, str] = {
    "approach_hysteresis": "approach one pose from both sides",
    "backlash": "read a ladder of small loads through zero torque",
    "base_compliance": "put a reflector on the base, and turn joint 1 over its whole range",
    "force_sensor_bias": "read the unloaded force sensor in several orientations",
    "gravity_compensator": f"{_CURRENTS} of the joint, or change the pressure (or spring) of the compensator",
    "joint_cross_compliance": "load with pure moments",
    "joint_hardening": "read three or more load levels, small ones included, in both directions",
    "joint_windup": "read a ladder of small loads through zero torque",
    "link_compliance": "put a reflector on the elbow, and load from the side",
    "link_mass": f"{_CURRENTS}, or change the payload only at equal joint values",
    "load_com": "hang the same mass on two hooks",
    "load_direction": "level the base",
    "load_level": f"{_WEIGH}, and read the level again",
    "load_scale": f"{_WEIGH}, or hang a reference mass",
    "marker_seating": "exchange the reflectors",
    "stiction": "read each load while loading and while unloading",
    "thermal_growth": "come back to one pose every hour and log the temperature",
    "tool_compliance": "put reflectors on both sides of the flange",
    "tracker_drift": _FLOOR,
    "tracker_scale": _BAR,
    "tracker_step": _FLOOR,
    "transmission_error": "sweep the joint alone over its range",
    "wrist_coupling": "sweep joint 5 alone over its range",
}

_IN_TIME = ("tracker_drift", "tracker_step", "thermal_growth")  # later visits alone do not settle these
_PLAIN = "add loads in other directions or a reflector elsewhere on the arm"


def remedy(cause: str, rival: str, separable: bool) -> str | None:
    """What to do about a pair of causes, given by name.

    Args:
        cause: Name of one.
        rival: Name of the other.
        separable: Poses separate them.

    Returns:
        Advice where poses do not separate them, or not by themselves; else None.
    """
    changing = [name for name in (cause, rival) if name in _IN_TIME]
    if separable:
        return _FLOOR if any(name != "thermal_growth" for name in changing) else None
    pair = _PAIRS.get(frozenset((cause, rival)))
    if pair is not None:
        return pair
    singles = dict.fromkeys(_SINGLE[name] for name in (rival, cause) if name in _SINGLE)
    return ", or ".join(singles) or _PLAIN
