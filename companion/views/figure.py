"""A flight as the paper's Fig. 3 shows it: from above at an angle, in plan, in vertical profile."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
import scipy.spatial
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LightSource, LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from companion.geodesy import FloatArray
from companion.mission.mission import Mission
from companion.telemetry.export import shapes
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
from companion.world.zones import Zone

SIZE_IN = (14.0, 10.0)
DPI = 150
_BLOCKS = 110  # a side of the terrain seen at an angle: each block is a polygon
_AZIMUTH_DEG = -60.0  # of the viewer, from the east, left
_ELEVATION_DEG = 40
_SHOWN_IN_KM_M = 2e3  # from this width on
_HEIGHT = 0.3  # of the box of that view, in its longest side
_SUN = LightSource(azdeg=279.0, altdeg=50.0)  # in the west
_ABOVE = 1_000  # all surfaces
_TINTS = LinearSegmentedColormap.from_list(
    "heights", ["#fbf8ef", "#e9dfc3", "#cdb78c", "#a98d60", "#7d6542", "#55432a"]
)  # darker is higher: readable whatever colours the reader sees
PATH, _RADAR, _KEEP_OUT, _UNKNOWN = "#0050b5", "#c2389b", "#e8590c", "#c9ccd1"
_Style = dict[str, Any]
_HALO = [withStroke(linewidth=4.6, foreground="white")]
_LINE: _Style = {"color": PATH, "lw": 2.4, "path_effects": _HALO, "label": "planned path"}
_FLOWN: _Style = {"color": "black", "lw": 0.9, "label": "flown track"}
_MARK: _Style = {"ls": "", "mec": "black"}
_SCAN = _MARK | {"marker": "o", "ms": 5.5, "mfc": "white", "mec": PATH, "label": "scan (p_scan)"}
_START = _MARK | {"marker": "s", "ms": 9, "mfc": "#00a37a", "label": "start"}
_TARGET = _MARK | {"marker": "*", "ms": 17, "mfc": "#ffd60a", "label": "target"}
_FLOOR: _Style = {"color": "#222222", "lw": 0.8, "ls": "--", "label": "floor of the band"}
_CEILING: _Style = {"color": "black", "lw": 1.6, "ls": "-", "label": "ceiling of the band"}
_HATCHED: _Style = {"fc": _UNKNOWN, "hatch": "////", "ec": "#aeb3ba", "lw": 0.0}


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightFigure:
    """What is drawn of a flight: metres in the local frame, altitudes AMSL."""

    title: str
    known: KnownMap
    """The terrain, as far as it was seen or known in advance."""
    floor_amsl_m: float
    ceiling_amsl_m: float
    start_nea_m: tuple[float, float, float]
    targets_ne_m: tuple[tuple[float, float], ...]
    legs_nea_m: tuple[FloatArray, ...]  # (S, 3) each
    """The planned path in order as flown: each leg as far as its successor."""
    scans_nea_m: tuple[tuple[float, float, float], ...] = ()
    """Where scans were taken (p_scan)."""
    radars: tuple[Radar, ...] = ()
    zones: tuple[Zone, ...] = ()
    track_nea_m: FloatArray | None = None  # (N, 3)
    """Where the vehicle was."""
    caption: str = ""

    @classmethod
    def of(cls, mission: Mission, known: KnownMap, **shown: Any) -> "FlightFigure":
        """Of a mission over known terrain; shown: the rest, and what differs from the mission."""
        task = mission.task
        of_mission: dict[str, Any] = {
            "title": f"{mission.name}, profile {task.settings.profile.name}",
            "known": known,
            "radars": task.radars,
            "zones": task.zones,
            "floor_amsl_m": task.limits.floor_amsl_m,
            "ceiling_amsl_m": task.limits.ceiling_amsl_m,
            "targets_ne_m": mission.targets_ne_m,
        }
        return cls(**(of_mission | shown))

    @property
    def edges_m(self) -> tuple[FloatArray, FloatArray]:
        """Of the cells, north (rows + 1,) and east (columns + 1,)."""
        known = self.known
        rows, columns = (np.arange(count + 1) * known.cell_m for count in known.upper_m.shape)
        return known.north_min_m + rows, known.east_min_m + columns

    @property
    def path_nea_m(self) -> FloatArray:
        """All legs as one line, or the track if nothing was planned.  -> (S, 3)."""
        flown = () if self.track_nea_m is None else (self.track_nea_m,)
        return np.concatenate([np.empty((0, 3)), *(self.legs_nea_m or flown)])

    @property
    def unit(self) -> tuple[float, str]:
        """What lengths are shown in: how many metres, and its name."""
        widest_m = max(np.ptp(edges_m) for edges_m in self.edges_m)
        return (1e3, "km") if widest_m >= _SHOWN_IN_KM_M else (1.0, "m")

    @property
    def altitudes_m(self) -> tuple[float, float]:
        """Least and greatest altitude to show; terrain far above the ceiling is cut off."""
        known = self.known.upper_m[np.isfinite(shapes.heights_m(self.known))]
        flown = [line_nea_m[:, 2] for line_nea_m, _ in _lines(self)]
        band = [self.floor_amsl_m, self.ceiling_amsl_m, self.start_nea_m[2]]
        values = np.concatenate([*flown, band])
        low = 10.0 * math.floor(min(values.min(), known.min(initial=np.inf)) / 10.0)
        enough = self.ceiling_amsl_m + 0.4 * (self.ceiling_amsl_m - low)
        high = max(values.max(), min(known.max(initial=-np.inf), enough))
        return low, float(high + 0.06 * (high - low))


def save(canvas: Figure, path: Path) -> None:
    """Write a figure as what its name ends with; the same figure gives the same bytes."""
    kind = path.suffix.lower().removeprefix(".")
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with rc_context({"svg.hashsalt": "companion"}):
        canvas.savefig(path, format=kind, dpi=DPI, metadata=dates.get(kind))


def draw(figure: FlightFigure, path: Path) -> None:
    """Write the three views of a flight to a .png, .svg or .pdf file."""
    save(compose(figure), path)


def compose(figure: FlightFigure) -> Figure:
    """The three views of a flight: axes labelled "oblique", "plan" and "profile"."""
    canvas = Figure(figsize=SIZE_IN)
    FigureCanvasAgg(canvas)
    if figure.title:
        canvas.text(0.03, 0.957, figure.title, fontsize=17, weight="bold", parse_math=False)
        canvas.text(0.03, 0.931, figure.caption, fontsize=11, color="#444444", parse_math=False)
    box = (0.012, 0.37, 0.5, 0.55)
    draw_oblique(canvas.add_axes(box, projection="3d", label="oblique"), figure)
    plan = canvas.add_axes((0.572, 0.41, 0.36, 0.51), label="plan")
    draw_plan(plan, figure)
    profile = canvas.add_axes((0.06, 0.13, 0.905, 0.19), label="profile")
    draw_profile(profile, figure)
    add_legend(canvas, (plan, profile))
    return canvas


def add_legend(
    canvas: Figure, shown_in: Iterable[Axes], columns: int | None = None, bottom: float = 0.0
) -> None:
    """One legend of what is shown in some axes, each thing once; by default in two rows."""
    shown: _Style = {}
    for axes in shown_in:
        for artist, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, artist)
    columns = columns or math.ceil(len(shown) / 2)
    place: _Style = {"loc": "lower center", "bbox_to_anchor": (0.5, bottom), "frameon": False}
    canvas.legend(list(shown.values()), list(shown), ncols=columns, **place)


def _lines(figure: FlightFigure) -> list[tuple[FloatArray, _Style]]:
    """The path and the track, where there are any."""
    path = [(figure.path_nea_m, _LINE)] if figure.legs_nea_m else []
    return path + ([] if figure.track_nea_m is None else [(figure.track_nea_m, _FLOWN)])


def _marks(figure: FlightFigure) -> list[tuple[FloatArray, _Style]]:
    """Scans, start and targets; a target is as high as the path is next to it."""
    scans = np.array(figure.scans_nea_m).reshape(-1, 3)
    targets = np.array([(*point, figure.floor_amsl_m) for point in figure.targets_ne_m])
    path = figure.path_nea_m
    if len(path):
        targets[:, 2] = path[scipy.spatial.KDTree(path[:, :2]).query(targets[:, :2])[1], 2]
    marks = [(scans, _SCAN), (np.array([figure.start_nea_m]), _START), (targets, _TARGET)]
    return [(points, style) for points, style in marks if len(points)]


def draw_plan(axes: Axes, figure: FlightFigure) -> None:
    """From above: terrain, radars, keep-outs and the path."""
    unit_m, unit = figure.unit
    north, east = (edges_m / unit_m for edges_m in figure.edges_m)
    heights = np.ma.masked_invalid(shapes.heights_m(figure.known) / unit_m)
    low, high = (altitude / unit_m for altitude in figure.altitudes_m)
    span: _Style = {"vmin": low, "vmax": high}
    colours = axes.pcolormesh(east, north, heights, cmap=_TINTS, rasterized=True, **span)
    scale = axes.inset_axes((1.03, 0.0, 0.03, 1.0))
    is_cut = heights.count() > 0 and heights.max() > high
    label = f"terrain, {unit} AMSL"
    Colorbar(scale, colours, extend="max" if is_cut else "neither", label=label)
    for level_m, style in ((figure.floor_amsl_m, _FLOOR), (figure.ceiling_amsl_m, _CEILING)):
        scale.axhline(level_m / unit_m, **style)
        if heights.count() and heights.min() < level_m / unit_m < heights.max():
            middles = (east[1:] + east[:-1]) / 2, (north[1:] + north[:-1]) / 2
            line = {"colors": style["color"], "linewidths": style["lw"], "linestyles": style["ls"]}
            axes.contour(*middles, heights, [level_m / unit_m], **line)
    if heights.count() < heights.size:
        axes.patch.set(**_HATCHED)
        axes.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, label="unknown ground", **_HATCHED))
    for radar in figure.radars:
        _draw_radar(axes, radar, figure)
    for keep_out in figure.zones:
        style = {"fc": to_rgba(_KEEP_OUT, 0.3), "ec": _KEEP_OUT, "hatch": "xx", "lw": 1.5}
        axes.add_patch(
            Polygon(shapes.outline_ne_m(keep_out)[:, ::-1] / unit_m, label="keep-out", **style)
        )
    for points_nea_m, style in _lines(figure) + _marks(figure):
        axes.plot(points_nea_m[:, 1] / unit_m, points_nea_m[:, 0] / unit_m, **style)
    axes.set(xlim=east[[0, -1]], ylim=north[[0, -1]], aspect="equal", title="Plan")
    axes.set(xlabel=f"east of the origin, {unit}", ylabel=f"north of the origin, {unit}")


def _draw_radar(axes: Axes, radar: Radar, figure: FlightFigure) -> None:
    """How far the radar sees within the band, its range, and its name where there is room."""
    unit_m, _ = figure.unit
    north, east, altitude = radar.centre_nea_m
    off_m = altitude - min(max(altitude, figure.floor_amsl_m), figure.ceiling_amsl_m)
    widest_m = math.sqrt(max(radar.range_m**2 - off_m**2, 0.0))
    centre = (east / unit_m, north / unit_m)
    fill: _Style = {"fc": to_rgba(_RADAR, 0.28), "ec": _RADAR, "label": "radar, within the band"}
    axes.add_patch(Circle(centre, widest_m / unit_m, **fill))
    rim: _Style = {"fill": False, "ec": _RADAR, "ls": ":", "label": "radar, full range"}
    axes.add_patch(Circle(centre, radar.range_m / unit_m, **rim))
    if 0.014 * np.ptp(figure.edges_m[1]) * len(radar.name) < 2.0 * widest_m:
        style: _Style = {"fontsize": 7, "ha": "center", "va": "center", "color": "#5c0f46"}
        style["path_effects"] = [withStroke(linewidth=1.5, foreground="white", alpha=0.6)]
        axes.text(*centre, radar.name, clip_on=True, parse_math=False, **style)


def draw_profile(axes: Axes, figure: FlightFigure) -> None:
    """Along the path: the terrain under it, the radars it passes, and its altitude."""
    unit_m, unit = figure.unit
    path = figure.path_nea_m
    low, high = (altitude / unit_m for altitude in figure.altitudes_m)
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])[: len(path)] / unit_m
    under = shapes.under_m(figure.known, path[:, :2]) / unit_m
    axes.fill_between(along, low, under, color="#cdb78c", lw=0.0)
    axes.plot(along, under, color="#6b5433", lw=1.2, label="terrain under the path")
    if np.isnan(under).any():
        axes.fill_between(along, low, high, where=np.isnan(under), **_HATCHED)
    for radar in figure.radars:
        off_m = np.hypot(path[:, 0] - radar.centre_nea_m[0], path[:, 1] - radar.centre_nea_m[1])
        half_m = np.sqrt(np.maximum(radar.range_m**2 - off_m**2, 0.0))
        least, most = (radar.centre_nea_m[2] + half for half in (-half_m, half_m))
        seen: _Style = {"where": half_m > 0.0, "fc": to_rgba(_RADAR, 0.28), "lw": 0.0}
        axes.fill_between(along, least / unit_m, most / unit_m, **seen)
    axes.axhspan(
        figure.floor_amsl_m / unit_m, figure.ceiling_amsl_m / unit_m, fc=to_rgba(PATH, 0.07)
    )
    axes.axhline(figure.floor_amsl_m / unit_m, **_FLOOR)
    axes.axhline(figure.ceiling_amsl_m / unit_m, **_CEILING)
    if len(path):
        nearest = scipy.spatial.KDTree(path)
        for points_nea_m, style in _lines(figure) + _marks(figure):
            at = along if style is _LINE else along[nearest.query(points_nea_m)[1]]
            dots = {"ls": "", "marker": ".", "ms": 1.5} if style is _FLOWN else {}
            axes.plot(at, points_nea_m[:, 2] / unit_m, **(style | dots), clip_on=False, zorder=3)
        axes.set_xlim(0.0, max(along[-1], 1e-3))
    else:
        axes.text(0.5, 0.5, "nothing was planned or flown", transform=axes.transAxes, ha="center")
        axes.set_xticks([])
    axes.set(ylim=(low, high), title="Vertical profile along the path")
    axes.set(xlabel=f"distance along the path over ground, {unit}", ylabel=f"altitude, {unit} AMSL")


def draw_oblique(axes: Any, figure: FlightFigure) -> None:
    """Terrain, radars and keep-outs as surfaces, and the path over them, wherever it is hidden."""
    unit_m, unit = figure.unit
    low, high = figure.altitudes_m
    (south, *_, north_m), (west, *_, east_m) = figure.edges_m
    least, most = np.array([west, south, low]), np.array([east_m, north_m, high])
    spans = most - least
    stretch = _HEIGHT * spans[:2].max() / spans[2]
    cells = np.nan_to_num(shapes.heights_m(figure.known), nan=-np.inf)
    heights = shapes.highest(cells, math.ceil(max(cells.shape) / _BLOCKS))
    known = np.isfinite(heights)
    heights = np.where(known, heights, low).clip(max=high)
    rows, columns = heights.shape  # the outermost cells reach to the edge
    north, east = np.linspace(south, north_m, rows), np.linspace(west, east_m, columns)
    steps = {"dx": np.ptp(east) / len(east), "dy": np.ptp(north) / len(north)}
    colours = _SUN.shade(
        heights, _TINTS, blend_mode="soft", vmin=low, vmax=high, vert_exag=stretch, **steps
    )
    colours[~known] = to_rgba(_UNKNOWN)
    surface: _Style = {"rstride": 1, "cstride": 1, "linewidth": 0.0, "rasterized": True}
    place = (*np.meshgrid(east / unit_m, north / unit_m), heights / unit_m)
    axes.plot_surface(*place, facecolors=colours, shade=False, antialiased=False, **surface)
    threats = [(shapes.ball_nea_m(radar, (low, high), 30), _RADAR) for radar in figure.radars]
    threats += [(shapes.walls_nea_m(zone, (low, high)), _KEEP_OUT) for zone in figure.zones]
    for grid, colour in threats:
        corners = np.clip(grid[..., [1, 0, 2]], least, most) / unit_m
        axes.plot_surface(*np.moveaxis(corners, -1, 0), color=colour, alpha=0.22, **surface)
    for points_nea_m, style in [(figure.path_nea_m, _LINE), *_marks(figure)]:
        axes.plot(*(points_nea_m.T[[1, 0, 2]] / unit_m), **(style | {"zorder": _ABOVE}))
    limits = np.stack([least, most], axis=-1) / unit_m
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set(xlabel=f"east, {unit}", ylabel=f"north, {unit}", zlabel=f"altitude, {unit} AMSL")
    axes.zaxis.set_major_locator(MaxNLocator(4))
    axes.set_proj_type("ortho")
    axes.view_init(_ELEVATION_DEG, _AZIMUTH_DEG)
    axes.set_box_aspect(np.array([*spans[:2] / spans[:2].max(), _HEIGHT]), zoom=1.0)
    note = f"Seen at an angle; heights stretched {stretch:.1f} times"
    axes.text2D(0.5, 0.0, note, transform=axes.transAxes, ha="center", fontsize=12)
