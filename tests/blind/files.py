"""A case as the files a customer would have: robot, study, measurements."""

import csv
import io
from dataclasses import dataclass

import numpy as np

from tests.blind.setting import MARKERS, Noise, Setting

WRENCH = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


@dataclass(eq=False)
class Table:
    """Rows of a measurement file before they are written: names and numbers in the file's units."""

    pose: np.ndarray
    load: np.ndarray
    marker: np.ndarray
    repeat: np.ndarray
    q: np.ndarray
    xyz: np.ndarray
    extra: dict


def table_of(setting: Setting, given, readings, first: int = 1, names=None) -> Table:
    """Rows of readings (P, L, M, 3) m under their conditions."""
    design = setting.design
    visits, count = given.load.shape
    shape = (visits, count, len(MARKERS))
    names = [f"P{k:03d}" for k in range(first, first + visits)] if names is None else names
    index = [a.ravel() for a in np.indices(shape)]
    levels = len(design.levels)
    extra = {}
    if design.time:
        extra["time_s"] = given.time[index[0], index[1]].round(1)
    if design.temperature and design.time:
        extra["temperature_C"] = given.temperature[index[0], index[1]].round(3)
    if design.approach:
        extra |= {f"approach{j + 1}": given.approach[index[0], j].astype(int) for j in range(6)}
    if given.wrench is not None:
        extra |= {name: given.wrench[index[0], index[1], k] for k, name in enumerate(WRENCH)}
    load = np.array(design.loads)[given.load[index[0], index[1]]]
    repeat = 1 + index[1] // levels
    q = np.degrees(given.q)[index[0]].round(6)
    xyz = readings.reshape(-1, 3) * 1e3
    return Table(np.array(names)[index[0]], load, np.array(MARKERS)[index[2]], repeat, q, xyz.copy(), extra)


def measurements(table: Table) -> str:
    """The text of measurements.csv."""
    head = ["pose", "load", "marker", "repeat", *(f"q{j + 1}_deg" for j in range(6)), "x_mm", "y_mm", "z_mm"]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*head, *table.extra])
    columns = [table.pose, table.load, table.marker, table.repeat]
    numbers = [[f"{v:.6f}" for v in column] for column in (*table.q.T, *table.xyz.T)]
    more = [[str(v) for v in column] for column in table.extra.values()]
    writer.writerows(zip(*columns, *numbers, *more, strict=True))
    return out.getvalue()


def plan(table: Table) -> str:
    """The same visits as a plan file with its conditions; one row a shot."""
    head = ["pose", "load", "repeat", *(f"q{j + 1}_deg" for j in range(6)), *table.extra]
    first = table.marker == MARKERS[0]
    lines = [",".join(head)]
    for row in np.flatnonzero(first):
        cells = [table.pose[row], table.load[row], str(table.repeat[row]), *(f"{v:.6f}" for v in table.q[row])]
        lines.append(",".join([*cells, *(str(column[row]) for column in table.extra.values())]))
    return "\n".join(lines) + "\n"


def robot_file(setting: Setting) -> str:
    """The robot as its maker describes it, in a chain of joints."""
    arm = setting.world.arm
    text = 'name = "heavy arm"\nconvention = "chain"\nsource = "drawn for a test"\npayload_kg = 300\n'
    for j in range(6):
        text += f'\n[[joints]]\nname = "A{j + 1}"\nxyz_mm = {_mm(arm.offset[j])}\n'
        text += f"axis = {arm.axis[j].astype(int).tolist()}\n"
        text += f"lower_deg = {setting.lower[j]}\nupper_deg = {setting.upper[j]}\n"
        text += f"mass_kg = {arm.mass[j]}\ncom_mm = {_mm(arm.centre[j])}\n"
    return text + f"\n[flange]\nxyz_mm = {_mm(arm.offset[6])}\n"


def study_file(setting: Setting, stated: Noise) -> str:
    """study.toml for these measurements.

    Args:
        setting: Robot, markers, loads.
        stated: The noise that the study claims.
    """
    design, arm = setting.design, setting.world.arm
    text = '[robot]\nmodel = "robot.toml"\n'
    if arm.tool_mass:
        text += f"\n[tool]\nmass_kg = {arm.tool_mass}\ncom_mm = {_mm(arm.tool_centre)}\n"
    text += "\n[markers]\n" + "".join(f"{n} = {_mm(p)}\n" for n, p in zip(MARKERS, setting.nominal_marker, strict=True))
    for name, level, hook in zip(design.loads, design.levels, setting.attach, strict=True):
        text += f'\n[[loads]]\nid = "{name}"\n'
        if not level:
            text += "mass_kg = 0.0\n" + (f"attach_mm = {_mm(hook)}\n" if design.free else "")
        elif design.free:
            text += f"attach_mm = {_mm(hook)}\nwrench = [0, 0, {-level}, 0, 0, 0]\n"
        else:
            text += f"mass_kg = {round(level / 9.80665, 3)}\nattach_mm = {_mm(hook)}\n"
    text += f"\n[noise]\nreading_mm = {stated.reading * 1e3:.6g}\npose_jitter_urad = {stated.pose * 1e6:.6g}\n"
    text += f"reading_jitter_urad = {stated.shot * 1e6:.6g}\n"
    text += '\n[frames]\nmeasurement = "free"\nmarkers = "nominal"\n'
    text += '\n[model]\neffects = ["joint_compliance"]\nreference = "auto"\n'
    for pose in ([0, -60, 90, 0, 45, 0], [40, -45, 60, 30, 60, 20]):
        text += f"\n[[test_poses]]\njoints_deg = {pose}\nwrench = [0, 0, -1500, 0, 0, 0]\n"
    loads = [name for name, level in zip(design.loads, design.levels, strict=True) if level]
    text += f"\n[plan]\nposes = 4\nloads = {loads}\ncandidates = 400\nrefine = false\nloads_per_pose = {len(loads)}\n"
    return text.replace("'", '"') + "\n[constraints]\njoint_margin_deg = 2.0\nfloor_mm = 100.0\n"


def _mm(vector):
    return (np.asarray(vector) * 1e3).round(4).tolist()
