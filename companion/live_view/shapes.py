"""What is drawn, as triangles and lines in the coordinates of the scene: x east, y north, z up.

The scene is as wide whatever the flight: a forest of 300 m or a map of 110 km.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from companion.geodesy import FloatArray
from companion.live_view.ground import Ground
from companion.telemetry.flight import Flight

WIDTH: Final = 100.0  # of the scene
_HEIGHT: Final = 0.11  # of the range of altitudes that matters, in widths: mountains are seen
_NEAR_M: Final = 1000.0  # wide: a map of near things
_MOST_STRETCHED: Final = 8.0
BELOW: Final = 0.25  # of the ground: there lies what is not known
_TINTS: Final = Image.fromarray(
    np.array(
        [[(231, 226, 190), (214, 198, 146), (188, 158, 104), (152, 120, 76), (116, 88, 58)]],
        dtype=np.uint8,
    )
)
"""Altitudes in colours: darker is higher, whatever colours the reader sees."""
IndexArray = NDArray[np.uint32]


class Mesh(NamedTuple):
    """Triangles."""

    vertices: FloatArray  # (V, 3)
    faces: IndexArray  # (F, 3)

    @staticmethod
    def grid(points: FloatArray) -> "Mesh":
        """(M, N, 3) -> (M - 1) (N - 1) quads."""
        rows, columns, _ = points.shape
        index = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        return Mesh(points.reshape(-1, 3), faces.astype(np.uint32))


class Area(NamedTuple):
    """What the scene shows, ranges of north, east and altitude AMSL, and how it lies in there."""

    north_m: tuple[float, float]
    east_m: tuple[float, float]
    low_m: float
    high_m: float

    @staticmethod
    def of(flight: Flight) -> "Area":
        """The mission's map, from the ground that it starts from; of a log alone, its track's."""
        places = flight.places_nea_m
        if flight.has_mission:
            limits = flight.mission.task.limits
            low_m = min(float(places[0, 2]), limits.floor_amsl_m)
            return Area(limits.north_m, limits.east_m, low_m, limits.ceiling_amsl_m)
        low, high = places.min(axis=0), places.max(axis=0)
        middle, half = (low + high) / 2.0, 0.6 * max(float((high - low)[:2].max()), 50.0)
        north_m, east_m = ((float(at) - half, float(at) + half) for at in middle[:2])
        return Area(north_m, east_m, float(low[2]), float(high[2]))

    @property
    def width_m(self) -> float:
        """Of its longer side."""
        return max(self.north_m[1] - self.north_m[0], self.east_m[1] - self.east_m[0])

    @property
    def stretch(self) -> float:
        """How many times larger heights are drawn: mountains are seen from above; trees are not."""
        if self.width_m < _NEAR_M:
            return 1.0
        wanted = _HEIGHT * self.width_m / max(self.high_m - self.low_m, 1.0)
        return min(max(math.floor(2.0 * wanted) / 2.0, 1.0), _MOST_STRETCHED)

    def scene(self, places_nea_m: FloatArray) -> FloatArray:
        """Places in the scene.  (..., 3) north, east, altitude -> (..., 3) x, y, z."""
        north, east, altitude = np.moveaxis(np.asarray(places_nea_m, dtype=np.float64), -1, 0)
        aside = east - sum(self.east_m) / 2.0, north - sum(self.north_m) / 2.0
        points = np.stack([*aside, (altitude - self.low_m) * self.stretch], axis=-1)
        return points * (WIDTH / self.width_m)

    @property
    def grid_step_m(self) -> float:
        """A round length: some ten of them across the map."""
        about_m = self.width_m / 10.0
        power = 10.0 ** math.floor(math.log10(about_m))
        return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= about_m)


# --- the ground


def painted(mesh: Mesh, area: Area) -> trimesh.Trimesh:
    """Ground in colours by altitude, darkest a little above the area."""
    top = area.high_m + 0.1 * (area.high_m - area.low_m)
    share = mesh.vertices[:, 2] / max(area.scene(np.array([0.0, 0.0, top]))[2], 1e-3)
    uv = np.stack([share.clip(0.01, 0.99), np.full(len(share), 0.5)], axis=-1)
    matt = PBRMaterial(baseColorTexture=_TINTS, metallicFactor=0.0, doubleSided=True)  # type: ignore[no-untyped-call]
    colours = TextureVisuals(uv=uv, material=matt)  # type: ignore[no-untyped-call]
    drawn = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=colours, process=False)
    assert drawn.vertex_normals is not None  # asked for, they are kept, and it is drawn smooth
    return drawn


def cells_mesh(ground: Ground, area: Area, kind: int) -> Mesh:
    """A quad for each cell of a kind; corners are as high as those about them in the mean."""
    drawn = ground.kind == kind
    height = np.pad(np.where(drawn, ground.height_m, 0.0).astype(np.float64), 1)
    total, number = (
        grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]
        for grid in (height, np.pad(drawn.astype(np.float64), 1))
    )
    corners = np.arange(total.size).reshape(total.shape)
    sw, se = corners[:-1, :-1][drawn], corners[:-1, 1:][drawn]
    nw, ne = corners[1:, :-1][drawn], corners[1:, 1:][drawn]
    faces = np.concatenate([np.stack([sw, se, ne], -1), np.stack([sw, ne, nw], -1)])
    used, faces = np.unique(faces, return_inverse=True)
    row, column = np.unravel_index(used, total.shape)
    north_m = ground.north_min_m + row * ground.cell_m
    east_m = ground.east_min_m + column * ground.cell_m
    places = np.stack([north_m, east_m, (total / np.maximum(number, 1.0))[row, column]], axis=-1)
    return Mesh(area.scene(places), faces.reshape(-1, 3).astype(np.uint32))


# --- lines, and the vehicle


def segments(points: FloatArray) -> FloatArray:
    """The pieces of a line.  (N, 3) -> (N - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def dart() -> Mesh:
    """The vehicle: an arrowhead 1.8 units long that points to +x."""
    vertices = [[1.08, 0, 0], [-0.72, 0.72, 0], [-0.36, 0, 0], [-0.72, -0.72, 0], [-0.36, 0, 0.4]]
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 2], [3, 2, 0]]
    return Mesh(np.array(vertices), np.array(faces, dtype=np.uint32))
