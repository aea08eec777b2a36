"""Kinematics of an 8-joint arm: dual quaternions against 4x4 matrices, in one run on one thread."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np

from benchmarks.clock import line, timed
from identify.dual_quaternions.chain import dual_chain, forward, pose_and_jacobian, postures
from identify.dual_quaternions.elastic import twist_jacobian
from identify.dual_quaternions.placements import to_matrix
from identify.kinematics import flange_poses, jacobian
from identify.kinematics import forward as matrix_forward
from identify.robot import Robot
from identify.robot_files import load_robot
from identify.threads import one_thread

COUNT = 100_000
PART = 1024


def _peak_mb(call: Callable[[], object]) -> float:
    """Largest memory that a call holds beyond what was there before, its result included, MB."""
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def _products(robot: Robot, q: np.ndarray, *, jacobians: bool) -> tuple[np.ndarray, np.ndarray]:
    """Flange (V, 4, 4) and Jacobian (V, 6, n) of turning joints by plain products of matrices, part by part."""
    poses = np.empty((len(q), 4, 4))
    columns = np.empty((len(q) if jacobians else 0, 6, robot.n))
    for start in range(0, len(q), PART):
        part = slice(start, start + PART)
        cosine, sine = np.cos(q[part]), np.sin(q[part])
        here = np.broadcast_to(robot.placements[0], (len(cosine), 4, 4))
        axes, origins = np.empty((len(cosine), robot.n, 3)), np.empty((len(cosine), robot.n, 3))
        for i in range(robot.n):
            axes[:, i], origins[:, i] = here[:, :3, 2], here[:, :3, 3]
            turn = np.zeros((len(cosine), 4, 4))
            turn[:, 0, 0] = turn[:, 1, 1] = cosine[:, i]
            turn[:, 1, 0], turn[:, 0, 1] = sine[:, i], -sine[:, i]
            turn[:, 2, 2] = turn[:, 3, 3] = 1.0
            here = here @ turn @ robot.placements[i + 1]
        poses[part] = here
        if jacobians:
            columns[part, :3] = np.cross(axes, here[:, None, :3, 3] - origins).swapaxes(1, 2)
            columns[part, 3:] = axes.swapaxes(1, 2)
    return poses, columns


def main() -> None:
    robot = load_robot("sda5f_r1")
    chain = dual_chain(robot)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (COUNT, robot.n))

    def batch() -> np.ndarray:
        frames = matrix_forward(robot, q)
        return jacobian(frames, frames.flange_origin)

    roads = {
        "dual quaternions": (lambda: forward(chain, q), lambda: pose_and_jacobian(chain, q)),
        "identify.kinematics": (lambda: flange_poses(robot, q), batch),
        "products of 4x4": (
            lambda: _products(robot, q, jacobians=False)[0], lambda: _products(robot, q, jacobians=True)
        ),
    }  # fmt: skip
    with one_thread():
        seconds = {}
        for name, calls in roads.items():
            for what, call in zip(("flange", "flange and Jacobian"), calls, strict=True):
                _, wall, cpu = timed(call)
                seconds[name, what] = cpu
                wanted = "under 1 s" if name == "dual quaternions" else "-"
                line(f"{what}: {name}", f"{wall:.2f} s wall {cpu:.2f} s CPU", wanted)
                line("", f"{_peak_mb(call):.0f} MB held at most", "-")
    for name in list(roads)[1:]:
        ratios = [seconds[name, what] / seconds["dual quaternions", what] for what in ("flange", "flange and Jacobian")]
        line(f"CPU of {name} / dual", f"{ratios[0]:.2f}, {ratios[1]:.2f}", "said as it is")
    gap = np.abs(to_matrix(forward(chain, q)) - flange_poses(robot, q)).max()
    line("largest difference of a flange's elements", f"{gap:.1e}", "below 1e-10")
    frames, few = matrix_forward(robot, q[:1000]), postures(chain, q[:1000])
    gap = np.abs(twist_jacobian(few, np.zeros(3)) - jacobian(frames, frames.flange_origin)).max()
    line("largest difference of a Jacobian's elements", f"{gap:.1e}", "below 1e-10")
