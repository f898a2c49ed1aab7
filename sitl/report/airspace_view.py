"""Fence and obstacles of a fleet from above. Readable in grey: the fence is dashed and dotted, obstacles are hatched."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from companion.geometry.airspace import Airspace, Cylinder

FENCE: dict[str, Any] = {"color": "#000000", "linewidth": 1.4, "linestyle": (0, (6, 2, 1, 2))}
OBSTACLE: dict[str, Any] = {"facecolor": "white", "edgecolor": "#444444", "hatch": "////", "linewidth": 1.0}


def draw_airspace(axes: Axes, airspace: Airspace) -> None:
    """The polygon of the fence and all obstacles, with one legend entry for each kind."""
    corners = airspace.fence.corners_enu_m
    if corners:
        xs, ys = zip(*corners, corners[0], strict=True)
        axes.plot(xs, ys, **FENCE, label="fence")
    for index, obstacle in enumerate(airspace.obstacles):
        label = "" if index else "obstacle"
        if isinstance(obstacle, Cylinder):
            axes.add_patch(Circle(obstacle.centre_enu_m, obstacle.radius_m, **OBSTACLE, label=label))
        else:
            (x, y, _), (far_x, far_y, _) = obstacle.min_enu_m, obstacle.max_enu_m
            axes.add_patch(Rectangle((x, y), far_x - x, far_y - y, **OBSTACLE, label=label))
