"""Collision geometry of URDF links as capsules that hold it.

A cylinder and a capsule keep their radius; a box gets a capsule along its longest side with half the diagonal of its
cross section; a sphere is a capsule of no length. Meshes are not read: a body with one is drawn by its joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identify.arrays import Floats, frozen
from identify.robot import Shape

__all__ = ["Collision", "shapes_of_body"]


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

    def capsule(self) -> tuple[Floats, float]:
        """Ends (2, 3) of the axis in the link's frame and radius of the capsule around it, m."""
        axis, radius, length = 2, self.sizes[0], 0.0
        if self.kind == "box":
            axis = int(np.argmax(self.sizes))
            length = self.sizes[axis]
            radius = float(np.linalg.norm(np.delete(self.sizes, axis))) / 2
        elif self.kind != "sphere":
            length = self.sizes[1]
        ends = np.array([-0.5, 0.5])[:, None] * length * np.eye(3)[axis]
        return ends @ self.placement[:3, :3].T + self.placement[:3, 3], radius


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
        ends, radius = item.capsule()
        shapes.append(Shape(name, body, frozen(ends @ placement[:3, :3].T + placement[:3, 3]), radius))
    return tuple(shapes)
