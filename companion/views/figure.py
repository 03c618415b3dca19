"""A flight as the paper's Fig. 3 shows it: from above at an angle, in plan, in vertical profile."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from companion.geodesy import FloatArray
from companion.world.threats import KeepOut, Radar

SIZE_IN = (14.0, 10.0)
DPI = 150
_SURFACE_CELLS = 110  # cells a side of the terrain in the view from an angle
_ELEVATION_DEG = 42.0
_TINTS = LinearSegmentedColormap.from_list(
    "heights", ["#fbf8ef", "#e9dfc3", "#cdb78c", "#9f8256", "#6b5433", "#3d2f1d"]
)  # darker is higher: readable whatever colours the reader sees
_PATH, _TRACK, _RADAR, _KEEP_OUT, _UNKNOWN = "#0050b5", "#000000", "#c2389b", "#e8590c", "#c9ccd1"
_HALO = [withStroke(linewidth=4.5, foreground="white")]
_SCAN = {"ls": "", "marker": "o", "ms": 5.5, "mfc": "white", "mec": _PATH, "mew": 1.3}
_START = {"ls": "", "marker": "s", "ms": 9, "mfc": "#00a37a", "mec": "black"}
_TARGET = {"ls": "", "marker": "*", "ms": 17, "mfc": "#ffd60a", "mec": "black"}
_FLOOR = {"colors": "#333333", "linewidths": 0.7, "linestyles": "dashed"}
_CEILING = {"colors": "black", "linewidths": 1.5, "linestyles": "solid"}


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TerrainPicture:
    """Heights of the cells of a lattice; not finite where the ground is unknown."""

    north_edges_m: FloatArray  # (rows + 1,)
    east_edges_m: FloatArray  # (columns + 1,)
    heights_m: FloatArray  # (rows, columns), rows to the north, columns to the east

    def under_m(self, points_ne_m: FloatArray) -> FloatArray:
        """Height of the cell that holds each point, nan where unknown.  (..., 2) -> (...)."""
        row = np.searchsorted(self.north_edges_m, points_ne_m[..., 0], side="right") - 1
        column = np.searchsorted(self.east_edges_m, points_ne_m[..., 1], side="right") - 1
        rows, columns = self.heights_m.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        height = self.heights_m[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.where(inside & np.isfinite(height), height, np.nan)

    def coarser(self) -> "TerrainPicture":
        """The highest known height of each block of cells: few enough to draw one by one."""
        step = max(math.ceil(max(self.heights_m.shape) / _SURFACE_CELLS), 1)
        first = [np.arange(0, cells, step) for cells in self.heights_m.shape]
        known = np.where(np.isfinite(self.heights_m), self.heights_m, -np.inf)
        highest = np.maximum.reduceat(np.maximum.reduceat(known, first[0], 0), first[1], 1)
        return TerrainPicture(
            north_edges_m=self.north_edges_m[[*first[0], -1]],
            east_edges_m=self.east_edges_m[[*first[1], -1]],
            heights_m=np.where(np.isfinite(highest), highest, np.nan),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightFigure:
    """What is drawn of a flight: metres in the local frame, altitudes AMSL."""

    title: str
    terrain: TerrainPicture
    floor_amsl_m: float
    ceiling_amsl_m: float
    start_nea_m: tuple[float, float, float]
    targets_ne_m: tuple[tuple[float, float], ...]
    legs_nea_m: tuple[FloatArray, ...]  # (S, 3) each
    """The planned path in order as flown; each leg as far as its successor."""
    scans_nea_m: tuple[tuple[float, float, float], ...] = ()
    """Where scans were taken (p_scan)."""
    radars: tuple[Radar, ...] = ()
    keep_outs: tuple[KeepOut, ...] = ()
    track_nea_m: FloatArray | None = None  # (N, 3)
    """Where the vehicle really was."""
    caption: str = ""

    @property
    def path_nea_m(self) -> FloatArray:
        """All legs as one line, or the track if nothing was planned.  -> (S, 3)."""
        lines = self.legs_nea_m or (() if self.track_nea_m is None else (self.track_nea_m,))
        return np.concatenate([np.empty((0, 3)), *lines])

    @property
    def altitudes_m(self) -> tuple[float, float]:
        """Least and greatest altitude to show."""
        ground = self.terrain.heights_m[np.isfinite(self.terrain.heights_m)]
        shown = [ground, self.path_nea_m[:, 2], [self.start_nea_m[2]]]
        values = np.concatenate([*shown, [self.floor_amsl_m, self.ceiling_amsl_m]])
        return float(values.min()), float(values.max() + 0.06 * np.ptp(values) + 1.0)


def draw(figure: FlightFigure, path: Path) -> None:
    """Write the three views of a flight to a PNG file."""
    compose(figure).savefig(path, format="png", dpi=DPI)


def compose(figure: FlightFigure) -> Figure:
    """The three views of a flight: axes "oblique", "plan" and "profile"."""
    canvas = Figure(figsize=SIZE_IN)
    FigureCanvasAgg(canvas)
    canvas.text(0.03, 0.965, figure.title, fontsize=17, weight="bold", parse_math=False)
    canvas.text(0.03, 0.938, figure.caption, fontsize=11, color="#444444", parse_math=False)
    _draw_oblique(canvas.add_axes((0.0, 0.33, 0.51, 0.6), projection="3d"), figure)
    plan = canvas.add_axes((0.565, 0.385, 0.36, 0.53), label="plan")
    _draw_plan(plan, figure)
    profile = canvas.add_axes((0.06, 0.125, 0.905, 0.19), label="profile")
    _draw_profile(profile, figure)
    shown: dict[str, Any] = {}
    for axes in (plan, profile):
        for artist, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, artist)
    canvas.legend(
        list(shown.values()),
        list(shown),
        loc="lower center",
        bbox_to_anchor=(0.5, 0.008),
        ncols=math.ceil(len(shown) / 2) if len(shown) > 7 else max(len(shown), 1),
        frameon=False,
        fontsize=10,
        handlelength=2.4,
    )
    return canvas


def _draw_plan(axes: Axes, figure: FlightFigure) -> None:
    terrain = figure.terrain
    north, east = terrain.north_edges_m / 1e3, terrain.east_edges_m / 1e3
    heights = np.ma.masked_invalid(terrain.heights_m) / 1e3
    axes.patch.set(facecolor=_UNKNOWN, hatch="////", edgecolor="#b3b7bd", linewidth=0)
    colours = axes.pcolormesh(east, north, heights, cmap=_TINTS, norm=_tint_norm(figure))
    scale = axes.inset_axes((1.03, 0.0, 0.03, 1.0))
    bar = axes.get_figure(root=True).colorbar(colours, cax=scale)
    bar.set_label("terrain, km AMSL")
    for level_m, name, style in (
        (figure.floor_amsl_m, "floor of the band", _FLOOR),
        (figure.ceiling_amsl_m, "ceiling of the band", _CEILING),
    ):
        line = {"color": style["colors"], "lw": style["linewidths"], "ls": style["linestyles"]}
        axes.plot([], [], **line, label=name)
        scale.axhline(level_m / 1e3, **line)
        if heights.count() and heights.min() < level_m / 1e3 < heights.max():
            middles = (east[1:] + east[:-1]) / 2, (north[1:] + north[:-1]) / 2
            axes.contour(*middles, heights, [level_m / 1e3], **style)
    _draw_threats(axes, figure)
    if heights.count() < heights.size:
        label = "unknown ground"
        axes.add_patch(
            Patch(facecolor=_UNKNOWN, hatch="////", edgecolor="#b3b7bd", label=label, visible=False)
        )
    _draw_places(axes, figure)
    axes.set(xlim=east[[0, -1]], ylim=north[[0, -1]], aspect="equal", title="Plan")
    axes.set(xlabel="east of the origin, km", ylabel="north of the origin, km")
