"""A flight as the paper's Fig. 3 shows it: from above at an angle, in plan, in vertical profile."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
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
from matplotlib.ticker import FuncFormatter, MaxNLocator

from companion.geodesy import FloatArray
from companion.mission.journal import ScanAsked
from companion.mission.mission import Mission
from companion.planner.offline import OfflineFlight
from companion.planner.settings import Task
from companion.telemetry.export import shapes
from companion.telemetry.flight import Flight, joined_nea_m
from companion.telemetry.flight_summary import FlightSummary
from companion.views.words import counted, metres
from companion.world.known_map import KnownMap, empty_map

DPI = 150
_SIZE_IN = (14.0, 10.0)
_BLOCKS = 110  # a side of the terrain seen at an angle: each block is a polygon
_AZIMUTH_DEG = -60.0  # of the viewer, from the east, left
_ELEVATION_DEG = 40
_SHOWN_IN_KM_M = 2e3  # from this width on
_HEIGHT = 0.3  # of the box of that view, in its longest side
_SUN = LightSource(azdeg=279.0, altdeg=50.0)  # in the west
_ABOVE = 1_000  # all surfaces
_LINE_POINTS = 2000  # about as many of a recorded flight: each is kept in the report
_SPACING_M = 100.0  # of the points of a route that was planned without a vehicle
_TINTS = LinearSegmentedColormap.from_list(
    "heights", ["#fbf8ef", "#e9dfc3", "#cdb78c", "#a98d60", "#7d6542", "#55432a"]
)  # darker is higher: readable whatever colours the reader sees
PATH, _RADAR, _KEEP_OUT, _UNKNOWN = "#0050b5", "#c2389b", "#e8590c", "#c9ccd1"
_KEEP_IN = "#787878"
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
_NAME: _Style = {"fontsize": 7, "ha": "center", "va": "center", "color": "#5c0f46"}
_NAME |= {"clip_on": True, "parse_math": False}
_SEEN: _Style = {"fc": to_rgba(_RADAR, 0.28), "ec": _RADAR, "label": "radar, within the band"}
_BARRED: _Style = {"fc": to_rgba(_KEEP_OUT, 0.3), "ec": _KEEP_OUT, "hatch": "xx", "lw": 1.5}
_BARRED |= {"label": "keep-out"}
_ALLOWED: _Style = {"fc": "none", "ec": _KEEP_IN, "lw": 1.5, "label": "keep-in"}


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightFigure:
    """What is drawn of a flight: metres in the local frame, altitudes AMSL."""

    task: Task
    """Its band of altitudes, radars and zones, the vehicle's own too."""
    known: KnownMap
    """The terrain, as far as it was seen or known in advance."""
    start_nea_m: tuple[float, float, float]
    targets_ne_m: tuple[tuple[float, float], ...]
    legs_nea_m: tuple[FloatArray, ...]  # (S, 3) each
    """The planned path in order as flown: each leg as far as its successor."""
    scans_nea_m: tuple[tuple[float, float, float], ...] = ()
    """Where scans were taken (p_scan)."""
    track_nea_m: FloatArray | None = None  # (N, 3)
    """Where the vehicle was."""
    title: str = ""
    caption: str = ""

    @property
    def band_m(self) -> tuple[float, float]:
        """Floor and ceiling."""
        return self.task.limits.floor_amsl_m, self.task.limits.ceiling_amsl_m

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
    def unit(self) -> tuple[str, FuncFormatter]:
        """What lengths are shown in, and what writes metres so; all is drawn in metres."""
        widest_m = max(np.ptp(edges_m) for edges_m in self.edges_m)
        name, metres = ("km", 1e3) if widest_m >= _SHOWN_IN_KM_M else ("m", 1.0)
        return name, FuncFormatter(lambda length_m, _: f"{length_m / metres:g}")

    @property
    def altitudes_m(self) -> tuple[float, float]:
        """Least and greatest altitude to show; terrain far above the ceiling is cut off."""
        known, (floor_m, ceiling_m) = shapes.heights_m(self.known), self.band_m
        flown = [line_nea_m[:, 2] for line_nea_m, _ in self.lines]
        values = np.concatenate([*flown, [floor_m, ceiling_m, self.start_nea_m[2]]])
        low = 10.0 * math.floor(min(values.min(), np.nanmin(known, initial=np.inf)) / 10.0)
        enough = ceiling_m + 0.4 * (ceiling_m - low)
        high = max(values.max(), min(np.nanmax(known, initial=-np.inf), enough))
        return low, float(high + 0.06 * (high - low))

    @property
    def lines(self) -> list[tuple[FloatArray, _Style]]:
        """The path and the track, where there are any."""
        path = [(self.path_nea_m, _LINE)] if self.legs_nea_m else []
        return path + ([] if self.track_nea_m is None else [(self.track_nea_m, _FLOWN)])

    @property
    def marks(self) -> list[tuple[FloatArray, _Style]]:
        """Scans, start and targets; a target is as high as the path is next to it."""
        scans = np.array(self.scans_nea_m).reshape(-1, 3)
        targets = np.array([(*point, self.band_m[0]) for point in self.targets_ne_m])
        path = self.path_nea_m
        if len(path):
            targets[:, 2] = path[scipy.spatial.KDTree(path[:, :2]).query(targets[:, :2])[1], 2]
        marks = [(scans, _SCAN), (np.array([self.start_nea_m]), _START), (targets, _TARGET)]
        return [(points, style) for points, style in marks if len(points)]


def save(canvas: Figure, path: Path) -> None:
    """Write a figure as .png, .svg or .pdf; the same figure gives the same bytes."""
    kind = path.suffix.lower().removeprefix(".")
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with rc_context({"svg.hashsalt": "companion"}):
        canvas.savefig(path, format=kind, dpi=DPI, metadata=dates.get(kind))


def compose(figure: FlightFigure) -> Figure:
    """The three views of a flight: axes labelled "oblique", "plan" and "profile"."""
    canvas = Figure(figsize=_SIZE_IN)
    FigureCanvasAgg(canvas)
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
    canvas: Figure, shown_in: Iterable[Axes], columns: int = 6, bottom: float = 0.0
) -> None:
    """One legend of what is shown in some axes, each thing once."""
    shown: _Style = {}
    for axes in shown_in:
        artists, labels = axes.get_legend_handles_labels()
        shown = dict(zip(labels, artists, strict=True)) | shown
    place: _Style = {"loc": "lower center", "bbox_to_anchor": (0.5, bottom), "frameon": False}
    canvas.legend(list(shown.values()), list(shown), ncols=columns, **place)


def draw_plan(axes: Axes, figure: FlightFigure) -> None:
    """From above: terrain, radars as wide as they see within the band, zones and the path."""
    (north, east), (low, high) = figure.edges_m, figure.altitudes_m
    heights = np.ma.masked_invalid(shapes.heights_m(figure.known))
    span: _Style = {"vmin": low, "vmax": high, "cmap": _TINTS, "rasterized": True}
    colours = axes.pcolormesh(east, north, heights, **span)
    scale = axes.inset_axes((1.03, 0.0, 0.03, 1.0))
    unit, in_unit = figure.unit
    is_cut = heights.max() > high  # not where nothing is known
    style_of_scale: _Style = {"format": in_unit, "label": f"terrain, {unit} AMSL"}
    Colorbar(scale, colours, extend="max" if is_cut else "neither", **style_of_scale)
    middles = (east[1:] + east[:-1]) / 2, (north[1:] + north[:-1]) / 2
    for level_m, style in zip(figure.band_m, (_FLOOR, _CEILING), strict=True):
        scale.axhline(level_m, **style)
        if heights.min() < level_m < heights.max():
            line = {"colors": style["color"], "linewidths": style["lw"], "linestyles": style["ls"]}
            axes.contour(*middles, heights, [level_m], **line)
    if heights.count() < heights.size:
        axes.patch.set(**_HATCHED)
        axes.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, label="unknown ground", **_HATCHED))
    for radar in figure.task.radars:
        north_m, east_m, altitude_m = radar.centre_nea_m
        off_m = altitude_m - np.clip(altitude_m, *figure.band_m)
        within_m = math.sqrt(max(radar.range_m**2 - off_m**2, 0.0))
        axes.add_patch(Circle((east_m, north_m), within_m, **_SEEN))
        axes.text(east_m, north_m, radar.name, **_NAME)
    for zone in figure.task.zones:
        style = _ALLOWED if zone.keep_in else _BARRED
        axes.add_patch(Polygon(shapes.outline_ne_m(zone)[:, ::-1], **style))
    for points_nea_m, style in figure.lines + figure.marks:
        axes.plot(points_nea_m[:, 1], points_nea_m[:, 0], **style)
    axes.set(xlim=east[[0, -1]], ylim=north[[0, -1]], aspect="equal", title="Plan")
    axes.set(xlabel=f"east of the origin, {unit}", ylabel=f"north of the origin, {unit}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(in_unit)


def draw_profile(axes: Axes, figure: FlightFigure) -> None:
    """Along the path: the terrain under it, the radars it passes, and its altitude."""
    path, (low, high) = figure.path_nea_m, figure.altitudes_m
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    along = along[: len(path)]  # of no points none
    under = shapes.under_m(figure.known, path[:, :2])
    axes.fill_between(along, low, under, color="#cdb78c", lw=0.0)
    axes.plot(along, under, color="#6b5433", lw=1.2, label="terrain under the path")
    axes.fill_between(along, low, high, where=np.isnan(under), **_HATCHED)
    for radar in figure.task.radars:
        off_m = np.hypot(*(path[:, :2] - radar.centre_nea_m[:2]).T)
        half_m = np.sqrt(np.maximum(radar.range_m**2 - off_m**2, 0.0))
        least, most = (radar.centre_nea_m[2] + half for half in (-half_m, half_m))
        axes.fill_between(along, least, most, where=half_m > 0.0, fc=_SEEN["fc"], lw=0.0)
    axes.axhspan(*figure.band_m, fc=to_rgba(PATH, 0.07))
    for level_m, style in zip(figure.band_m, (_FLOOR, _CEILING), strict=True):
        axes.axhline(level_m, **style)
    if len(path):
        nearest = scipy.spatial.KDTree(path)
        for points_nea_m, style in figure.lines + figure.marks:
            at = along if style is _LINE else along[nearest.query(points_nea_m)[1]]
            dots = {"ls": "", "marker": ".", "ms": 1.5} if style is _FLOWN else {}
            axes.plot(at, points_nea_m[:, 2], **(style | dots), clip_on=False, zorder=3)
    unit, in_unit = figure.unit
    axes.set(xlim=(0.0, max([*along[-1:], 1.0])), ylim=(low, high))
    axes.set(title="Vertical profile along the path", ylabel=f"altitude, {unit} AMSL")
    axes.set_xlabel(f"distance along the path over ground, {unit}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(in_unit)


def draw_oblique(axes: Any, figure: FlightFigure) -> None:
    """Terrain, radars and zones as surfaces, and the path over them, wherever it is hidden."""
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
    place = (*np.meshgrid(east, north), heights)
    axes.plot_surface(*place, facecolors=colours, shade=False, antialiased=False, **surface)
    band_m = (low, high)
    threats = [(shapes.ball_nea_m(radar, band_m, 30), _RADAR) for radar in figure.task.radars]
    for zone in figure.task.zones:
        threats.append((shapes.walls_nea_m(zone, band_m), _KEEP_IN if zone.keep_in else _KEEP_OUT))
    for grid, colour in threats:
        corners = np.clip(grid[..., [1, 0, 2]], least, most)
        axes.plot_surface(*np.moveaxis(corners, -1, 0), color=colour, alpha=0.22, **surface)
    for points_nea_m, style in [(figure.path_nea_m, _LINE), *figure.marks]:
        axes.plot(*points_nea_m.T[[1, 0, 2]], **(style | {"zorder": _ABOVE}))
    axes.set(xlim=(west, east_m), ylim=(south, north_m), zlim=band_m)
    unit, in_unit = figure.unit
    axes.set(xlabel=f"east, {unit}", ylabel=f"north, {unit}", zlabel=f"altitude, {unit} AMSL")
    axes.zaxis.set_major_locator(MaxNLocator(4))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_formatter(in_unit)
    axes.set_proj_type("ortho")
    axes.view_init(_ELEVATION_DEG, _AZIMUTH_DEG)
    axes.set_box_aspect(np.array([*spans[:2] / spans[:2].max(), _HEIGHT]), zoom=1.0)
    note = f"Seen at an angle; heights stretched {stretch:.1f} times"
    axes.text2D(0.5, 0.0, note, transform=axes.transAxes, ha="center", fontsize=12)


# --- of flights


def draw_offline(flight: OfflineFlight, mission: Mission, truth: KnownMap, path: Path) -> float:
    """Draw a flight without a vehicle over the true terrain; its length in metres."""
    route = flight.route_nea_m(_SPACING_M)
    length_m = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
    subpaths = counted(len(flight.legs), "subpath")
    shown = FlightFigure(
        title=_title(mission),
        caption=f"planned without a vehicle: {subpaths}, {metres(length_m)}",
        task=mission.task,
        known=truth,
        start_nea_m=flight.scans_nea_m[0],
        targets_ne_m=mission.targets_ne_m,
        legs_nea_m=(route,),
        scans_nea_m=tuple(flight.scans_nea_m),
    )
    save(compose(shown), path)
    return length_m


def draw_flown(flown: FlightSummary, path: Path) -> None:
    """Draw a flight over the terrain that it came to know."""
    session = flown.session
    end = "in flight" if flown.end is None else f"{flown.end.outcome.value}: {flown.end.reason}"
    shown = FlightFigure(
        title=_title(session.mission),
        caption=f"{end}, after {session.now_s:,.0f} s; terrain as far as it was seen",
        task=session.mission.task,
        known=session.state.flight.known,
        start_nea_m=flown.track_nea_m[0] if flown.track_nea_m else (0.0, 0.0, 0.0),
        targets_ne_m=session.mission.targets_ne_m,
        legs_nea_m=tuple(joined_nea_m(planned.subpath for planned in flown.plans)),
        scans_nea_m=tuple(flown.scans_nea_m),
        track_nea_m=np.array(flown.track_nea_m) if len(flown.track_nea_m) > 1 else None,
    )
    save(compose(shown), path)


def _title(mission: Mission) -> str:
    return f"{mission.name}, profile {mission.task.settings.profile.name}"


def recorded_figure(flight: Flight, known: KnownMap | None) -> FlightFigure | None:
    """A recorded flight over known terrain; None: neither a position nor a subpath is recorded."""
    task = replace(flight.mission.task, zones=flight.zones_of(flight.decided))
    track, legs = flight.places_nea_m, flight.legs_nea_m()
    lines = [line for line in (track, *legs) if len(line)]
    if not lines:
        return None
    scans = (entry.centre_nea_m for _, entry in flight.entries if isinstance(entry, ScanAsked))
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    return FlightFigure(
        task=task,
        known=blank if known is None else known,
        start_nea_m=tuple(lines[0][0].tolist()),
        targets_ne_m=flight.decided.targets_ne_m,
        legs_nea_m=tuple(_thinned(leg, sum(map(len, legs))) for leg in legs),
        scans_nea_m=() if flight.mission.near else tuple(scans),  # a lidar's is there all the time
        track_nea_m=_thinned(track, len(track)) if len(track) > 1 else None,
    )


def _thinned(line_nea_m: FloatArray, total: int) -> FloatArray:
    """Some of its points, and the last; total: of all lines that are drawn together."""
    chosen = np.arange(0, len(line_nea_m), max(total // _LINE_POINTS, 1))
    return line_nea_m[np.union1d(chosen, [len(line_nea_m) - 1])]
