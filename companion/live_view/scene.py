"""The scene: what a flight was, knew and wanted at a moment, in three dimensions."""

import math
from typing import Any, Final, final

import numpy as np
import viser

from companion.geodesy import FloatArray
from companion.live_view import shapes
from companion.live_view.ground import GUESSED, PROVEN, Ground
from companion.live_view.recording import SECTORS
from companion.live_view.shapes import Area, Mesh
from companion.mission.journal import PlanAsked, PlanReady
from companion.telemetry.export.shapes import ball_nea_m, circle_ne_m, walls_nea_m
from companion.telemetry.flight import Decided, Flight
from companion.views.words import metres
from companion.world.zones import Zone

Rgb = tuple[int, int, int]
_PATH: Final[Rgb] = (0, 80, 181)
_RADAR: Final[Rgb] = (194, 56, 155)
_KEEP_OUT: Final[Rgb] = (232, 89, 12)
_VEHICLE: Final[Rgb] = (255, 214, 10)
_TRACK: Final[Rgb] = (20, 20, 20)
_GUIDE: Final[Rgb] = (0, 140, 110)
_SCAN: Final[Rgb] = (60, 150, 230)
_UNKNOWN: Final[Rgb] = (196, 200, 205)
_GUESSED: Final[Rgb] = (110, 140, 175)
_KEEP_IN: Final[Rgb] = (120, 120, 120)
_GRID: Final[Rgb] = (168, 172, 178)
_FAR: Final = 2000.0
_NOT_TOLD: Final = 65535  # of a sector of OBSTACLE_DISTANCE
_SWEPT_S: Final = 1.0  # a sweep that is older is no longer what a lidar sees
_TRACK_POINTS: Final = 1500
_CURVE_POINTS: Final = 80
_BALL_POINTS: Final = 64
_NOTHING: Final = np.zeros((1, 2, 3))
_NO_SHADOWS: Final[dict[str, Any]] = {"cast_shadow": False, "receive_shadow": False}


@final
class Scene:
    """Draws one flight; only what has changed is sent again."""

    def __init__(self, server: viser.ViserServer, flight: Flight) -> None:
        self._server, self._scene, self._flight = server, server.scene, flight
        self.area = Area.of(flight)
        self._decided: Decided | None = None
        """What is drawn of what was decided."""
        scene = self._scene
        scene.set_up_direction("+z")
        scene.world_axes.visible = False
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(hdri=None)
        scene.add_light_ambient("/light/ambient", intensity=2.2)
        scene.add_light_directional(
            "/light/sun", intensity=1.1, position=(-60.0, 50.0, 90.0), cast_shadow=False
        )
        scene.set_background_image(np.full((2, 2, 3), (238, 241, 245), dtype=np.uint8))
        self._draw_plate()
        self._vehicle = self._mesh("/vehicle", shapes.dart(), _VEHICLE, flat_shading=True)
        self._drop = self._lines("/drop", _NOTHING, _VEHICLE, 1.5)
        self._track = self._lines("/track", _NOTHING, _TRACK, 2.5)
        self._beams = self._lines("/sweep", _NOTHING, _SCAN, 1.0)

    def _draw_plate(self) -> None:
        """The whole map, of which nothing is known yet, with a grid and where north is."""
        area, low_m = self.area, self.area.low_m
        scale = shapes.WIDTH / area.width_m
        sides = float(scale * np.ptp(area.east_m)), float(scale * np.ptp(area.north_m))
        step = scale * area.grid_step_m
        lines: dict[str, Any] = {"cell_size": step, "section_size": step, "fade_distance": _FAR}
        lines |= {"cell_color": _GRID, "section_color": _GRID, "plane_color": _UNKNOWN}
        lines |= {"position": (0.0, 0.0, -shapes.BELOW), "plane_opacity": 1.0}
        self._scene.add_grid("/unknown", *sides, **lines)
        corner_nea_m = area.north_m[0], area.east_m[0], low_m
        self._label("/legend/grid", f"grid {metres(area.grid_step_m)}", corner_nea_m, "top-left")
        self._label("/legend/north", "N", (area.north_m[1], sum(area.east_m) / 2, low_m))

    def show(self, time_s: float) -> FloatArray:
        """Draw the flight as it was; where the vehicle is in the scene.  -> (3,)."""
        flight = self._flight
        row, [decided] = flight.row_at(time_s), flight.decided_at(np.array([time_s]))
        with self._server.atomic():
            place = self._show_vehicle(row)
            if decided is not self._decided:
                self._decided = decided
                self._group("/decided")
                self._draw_threats(flight.zones_of(decided))
                self._draw_targets(decided.targets_ne_m)
                self._draw_subpaths(decided)
                if decided.asked is not None:
                    self._draw_asked(decided.asked, decided.ready)
        return place

    def show_ground(self, ground: Ground) -> None:
        """Draw the terrain as it is known."""
        with self._server.atomic():
            self._group("/ground")
            proven = shapes.cells_mesh(ground, self.area, PROVEN)
            if len(proven.faces):
                mesh = shapes.painted(proven, self.area)
                self._scene.add_mesh_trimesh("/ground/proven", mesh, **_NO_SHADOWS)
            guessed = shapes.cells_mesh(ground, self.area, GUESSED)
            if len(guessed.faces):
                self._mesh("/ground/guessed", guessed, _GUESSED, opacity=0.38)

    # --- the parts

    def _show_vehicle(self, row: int) -> FloatArray:
        """The vehicle, its track, and what its lidar sees; where it is in the scene.  -> (3,)."""
        flight, place = self._flight, self.area.scene(self._flight.places_nea_m[row])
        turn = math.pi / 2.0 - flight.heading_rad(row)  # clockwise from north -> from x
        self._vehicle.wxyz = (math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2))
        self._vehicle.position = place
        self._drop.points = np.array([[place, [*place[:2], 0.0]]], dtype=np.float32)
        rows = np.unique(np.linspace(0, row, min(row + 1, _TRACK_POINTS)).astype(np.intp))
        track = shapes.segments(flight.places_nea_m[rows])
        for lines, pieces_nea_m in ((self._track, track), (self._beams, self._beams_nea_m(row))):
            pieces = self.area.scene(pieces_nea_m) if len(pieces_nea_m) else _NOTHING
            lines.points = pieces.astype(np.float32)
        return place

    def _beams_nea_m(self, row: int) -> FloatArray:
        """What a lidar passed over just now: lines from the vehicle.  -> (K, 2, 3)."""
        message = self._flight.newest(SECTORS, row, _SWEPT_S)
        if message is None:
            return np.zeros((0, 2, 3))
        reach_m = np.minimum(message.distances, message.max_distance) / 100.0  # centimetres
        is_told = np.array(message.distances) != _NOT_TOLD
        steps_deg = np.arange(len(is_told)) * (message.increment_f or message.increment)
        bearings = np.radians(message.angle_offset + steps_deg) + self._flight.heading_rad(row)
        rim = np.stack([np.cos(bearings), np.sin(bearings), 0.0 * bearings], -1) * reach_m[:, None]
        return self._flight.places_nea_m[row] + np.stack([0.0 * rim, rim], axis=1)[is_told]

    def _draw_threats(self, zones: tuple[Zone, ...]) -> None:
        """Of radars the spheres in which they see, of zones the walls, up to the ceiling."""
        radars = self._flight.mission.task.radars if self._flight.has_mission else ()
        band_m = self.area.low_m, self.area.high_m
        for number, radar in enumerate(radars):
            name, (north_m, east_m, altitude_m) = f"/decided/radar_{number}", radar.centre_nea_m
            self._surface(name, ball_nea_m(radar, band_m, _BALL_POINTS), _RADAR, 0.15)
            top_m = min(altitude_m + radar.range_m, self.area.high_m)
            self._label(f"{name}/label", radar.name, (north_m, east_m, top_m))
        for number, zone in enumerate(zones):
            colour, what = (_KEEP_IN, "keep-in") if zone.keep_in else (_KEEP_OUT, "keep-out")
            name, walls = f"/decided/zone_{number}", walls_nea_m(zone, band_m)
            self._surface(name, walls, colour, 0.25)
            self._curve(f"{name}/rim", walls[1], colour, 2.0)
            text = zone.name if what in zone.name else f"{what} {zone.name}".strip()
            self._label(f"{name}/label", text, walls[1].mean(axis=0))

    def _draw_targets(self, targets_ne_m: tuple[tuple[float, float], ...]) -> None:
        high_m = 0.14 * self.area.width_m / self.area.stretch
        for number, target_ne_m in enumerate(targets_ne_m, 1):
            name = f"/decided/target_{number}"
            pole = np.array(
                [(*target_ne_m, self.area.low_m + above_m) for above_m in (0.0, high_m)]
            )
            self._curve(name, pole, _KEEP_OUT, 3.0)
            text = "target" if len(targets_ne_m) == 1 else f"target {number}"
            self._point(f"{name}/head", pole[1], 0.8, _KEEP_OUT, text)

    def _draw_subpaths(self, decided: Decided) -> None:
        """The subpath that is flown, the next one, and what spans it."""
        leg, ready = decided.leg, decided.ready
        for name, plan, width in (("leg", leg, 6.0), ("next", ready, 3.0)):
            if plan is not None and (name == "leg" or plan is not leg):
                lengths_m = np.linspace(0.0, plan.subpath.length_m, _CURVE_POINTS)
                points_nea_m = plan.subpath.points_nea_m(lengths_m)
                self._curve(f"/decided/{name}", points_nea_m, _PATH, width)
        if ready is not None:
            self._curve("/decided/control", np.array(ready.control_nea_m), _PATH, 1.0)

    def _draw_asked(self, asked: PlanAsked, ready: PlanReady | None) -> None:
        """What the newest plan was asked for, its guide, and how far the terrain radar looked."""
        scan_nea_m, mission = np.array(asked.scan_nea_m), self._flight.mission
        self._point("/decided/p_scan", scan_nea_m, 0.3, _SCAN, "p_scan", "bottom-right")
        start_nea_m = np.array(asked.start_nea_m)
        self._point("/decided/p_prog", start_nea_m, 0.3, _PATH, "p_prog", "bottom-left")
        if ready is not None and ready.plan_id == asked.plan_id:
            ahead = np.array([math.sin(ready.guide_rad), math.cos(ready.guide_rad), 0.0])
            scan = self.area.scene(scan_nea_m)
            arrow = np.array([[scan, scan + 9.0 * ahead]], dtype=np.float32)
            sizes: dict[str, Any] = {"shaft_radius": 0.05, "head_radius": 0.2, "head_length": 0.7}
            self._scene.add_arrows("/decided/guide", arrow, _GUIDE, **sizes)
        if mission.near is None:
            ring = circle_ne_m(asked.scan_nea_m[:2], mission.task.settings.scan_range_m)
            self._curve("/decided/reach", np.insert(ring, 2, scan_nea_m[2], axis=1), _SCAN, 2.0)

    # --- nodes

    def _group(self, name: str) -> None:
        """An empty node to put others under."""
        self._scene.remove_by_name(name)
        self._scene.add_frame(name, show_axes=False)

    def _mesh(self, name: str, mesh: Mesh, colour: Rgb, **how: Any) -> viser.MeshHandle:
        how |= {"color": colour, "side": "double", **_NO_SHADOWS}
        return self._scene.add_mesh_simple(name, mesh.vertices, mesh.faces, **how)

    def _surface(self, name: str, grid_nea_m: FloatArray, colour: Rgb, opacity: float) -> None:
        """A surface through a grid of points, (M, N, 3)."""
        self._mesh(name, Mesh.grid(self.area.scene(grid_nea_m)), colour, opacity=opacity)

    def _lines(
        self, name: str, pieces: FloatArray, colour: Rgb, width: float
    ) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(
            name, pieces.astype(np.float32), colour, thickness=width, thickness_units="screen"
        )

    def _curve(self, name: str, points_nea_m: FloatArray, colour: Rgb, width: float) -> None:
        """A line through points, (N, 3)."""
        self._lines(name, shapes.segments(self.area.scene(points_nea_m)), colour, width)

    def _point(
        self,
        name: str,
        place_nea_m: FloatArray,
        radius: float,
        colour: Rgb,
        text: str,
        anchor: Any = "bottom-center",
    ) -> None:
        """A ball with a label; radius: in the scene."""
        place = self.area.scene(place_nea_m)
        self._scene.add_icosphere(
            name, radius=radius, color=colour, position=place, cast_shadow=False
        )
        self._add_label(f"{name}/label", text, np.array([0.0, 0.0, 0.6]), anchor)

    def _label(self, name: str, text: str, place_nea_m: Any, anchor: Any = "bottom-center") -> None:
        self._add_label(name, text, self.area.scene(np.array(place_nea_m)), anchor)

    def _add_label(self, name: str, text: str, place: FloatArray, anchor: Any) -> None:
        self._scene.add_label(name, text, position=place, anchor=anchor, font_screen_scale=0.9)
