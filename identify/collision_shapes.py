"""Collision geometry of URDF links as capsules that hold it.

A cylinder and a capsule keep their radius; a box becomes strips along its longest side, each held by a capsule; a
sphere is a capsule of no length. Meshes are not read: a body with one is drawn by its joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.robot import Shape

__all__ = ["Collision", "shapes_of_body"]

_MOST_STRIPS = 8  # capsules of one box


@dataclass(frozen=True, eq=False)
class Collision:
    """A checked ``<collision>``.

    Attributes:
        kind: box, cylinder, capsule, sphere or mesh.
        sizes: Box: three sides; cylinder and capsule: radius and length (along z); sphere: radius; m.
        placement: (4, 4) in the link's frame.
    """

    kind: str
    sizes: tuple[float, ...]
    placement: Floats

    def capsules(self) -> list[tuple[Floats, float]]:
        """Ends (2, 3) of the axes in the link's frame and radii of the capsules that hold it together, m."""
        if self.kind == "box":
            return [(self._placed(ends), radius) for ends, radius in _strips(np.array(self.sizes))]
        length = 0.0 if self.kind == "sphere" else self.sizes[1]
        ends = np.array([-0.5, 0.5])[:, None] * length * np.eye(3)[2]
        return [(self._placed(ends), self.sizes[0])]

    def _placed(self, ends: Floats) -> Floats:
        """Points (2, 3) of the shape's own frame in the link's frame, m."""
        moved: Floats = ends @ self.placement[:3, :3].T + self.placement[:3, 3]
        return moved


def _strips(sizes: Floats) -> list[tuple[Floats, float]]:
    """Ends (2, 3) and radii of capsules along the longest side of a box (3,), side by side over its second side."""
    third, second, longest = np.argsort(sizes)
    count = int(np.clip(np.rint(sizes[second] / sizes[third]), 1, _MOST_STRIPS))
    width = sizes[second] / count
    radius = float(np.hypot(width, sizes[third])) / 2
    strips = []
    for place in (np.arange(count) - (count - 1) / 2) * width:
        ends = np.zeros((2, 3))
        ends[:, longest], ends[:, second] = np.array([-0.5, 0.5]) * sizes[longest], place
        strips.append((ends, radius))
    return strips


def shapes_of_body(
    body: int, links: Mapping[str, Floats], collisions: Mapping[str, tuple[Collision, ...]]
) -> tuple[Shape, ...]:
    """The shapes of one body; none where a mesh is among them.

    Args:
        body: Its number, see `identify.robot.Shape`.
        links: Link -> its placement (4, 4) in the body's frame.
        collisions: Link -> its collision geometry.
    """
    found = [(name, placement, item) for name, placement in links.items() for item in collisions.get(name, ())]
    if any(item.kind == "mesh" for _, _, item in found):
        return ()
    shapes = []
    for name, placement, item in found:
        for ends, radius in item.capsules():
            shapes.append(Shape(name, body, frozen(ends @ placement[:3, :3].T + placement[:3, 3]), radius))
    return tuple(shapes)
