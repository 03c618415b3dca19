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
from companion.telemetry.export.shapes import ball_nea_m, circle_ne_m, outline_ne_m, walls_nea_m
from companion.telemetry.flight import Decided, Flight
from companion.views.words import metres
from companion.world.radars import Radar
from companion.world.zones import Zone

Rgb = tuple[int, int, int]
_PATH: Final[Rgb] = (0, 80, 181)
_RADAR: Final[Rgb] = (194, 56, 155)
_KEEP_OUT: Final[Rgb] = (232, 89, 12)
_VEHICLE: Final[Rgb] = (255, 214, 10)
_WHITE: Final[Rgb] = (255, 255, 255)
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
        self._sweep = self._lines("/sweep", _NOTHING, _SCAN, 1.0)

    def _draw_plate(self) -> None:
        """The whole map, of which nothing is known yet, with a grid and where north is."""
        area, low_m = self.area, self.area.low_m
        north_m, east_m = np.ptp(area.north_m), np.ptp(area.east_m)
        scale, below = shapes.WIDTH / area.width_m, (0.0, 0.0, -shapes.BELOW)
        step = scale * area.grid_step_m
        lines: dict[str, Any] = {"cell_size": step, "section_size": step, "fade_distance": _FAR}
        lines |= {"cell_color": _GRID, "section_color": _GRID, "plane_color": _UNKNOWN}
        sides = float(scale * east_m), float(scale * north_m)
        self._scene.add_grid("/unknown", *sides, position=below, plane_opacity=1.0, **lines)
        corner = area.scene(np.array([area.north_m[0], area.east_m[0], low_m]))
        self._label("/legend/grid", f"grid {metres(area.grid_step_m)}", corner, "top-left")
        north = np.array([area.north_m[1], sum(area.east_m) / 2, low_m])
        self._label("/legend/north", "N", area.scene(north))

    def show(self, time_s: float) -> FloatArray:
        """Draw the flight as it was; where the vehicle is in the scene.  -> (3,)."""
        flight = self._flight
        row, [decided] = flight.row_at(time_s), flight.decided_at(np.array([time_s]))
        here = self.area.scene(flight.places_nea_m[row])
        with self._server.atomic():
            self._show_vehicle(row, here)
            if decided is not self._decided:
                self._decided = decided
                self._group("/decided")
                radars = flight.mission.task.radars if flight.has_mission else ()
                for number, radar in enumerate(radars):
                    self._draw_radar(f"/decided/radar_{number}", radar)
                for number, zone in enumerate(flight.zones_of(decided)):
                    self._draw_zone(f"/decided/zone_{number}", zone)
                self._draw_targets(decided.targets_ne_m)
                self._draw_subpaths(decided)
                if decided.asked is not None:
                    self._draw_asked(decided.asked, decided.ready)
        return here

    def show_ground(self, ground: Ground) -> None:
        """Draw the terrain as it is known."""
        with self._server.atomic():
            self._group("/ground")
            proven, guessed = (
                shapes.cells_mesh(ground, self.area, each) for each in (PROVEN, GUESSED)
            )
            if len(proven.faces):
                mesh = shapes.painted(proven, self.area)
                self._scene.add_mesh_trimesh("/ground/proven", mesh, **_NO_SHADOWS)
            if len(guessed.faces):
                self._mesh("/ground/guessed", guessed, _GUESSED, opacity=0.38)

    # --- the parts

    def _show_vehicle(self, row: int, here: FloatArray) -> None:
        turn = math.pi / 2.0 - self._flight.heading_rad(row)  # clockwise from north -> from x
        self._vehicle.wxyz = (math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2))
        self._vehicle.position = here
        self._drop.points = np.array([[here, [*here[:2], 0.0]]], dtype=np.float32)
        rows = np.unique(np.linspace(0, row, min(row + 1, _TRACK_POINTS)).astype(np.intp))
        points = self.area.scene(self._flight.places_nea_m[rows])
        self._track.points = (shapes.segments(points) if row else _NOTHING).astype(np.float32)
        beams = self.area.scene(self._beams_nea_m(row))
        self._sweep.points = (beams if len(beams) else _NOTHING).astype(np.float32)

    def _beams_nea_m(self, row: int) -> FloatArray:
        """What a lidar passed over just now: lines from the vehicle.  -> (K, 2, 3)."""
        message = self._flight.newest(SECTORS, row, _SWEPT_S)
        if message is None:
            return np.zeros((0, 2, 3))
        reach_m = np.minimum(message.distances, message.max_distance) / 100.0  # centimetres
        told = np.array(message.distances) != _NOT_TOLD
        degrees = message.angle_offset + np.arange(len(told)) * (
            message.increment_f or message.increment
        )
        bearings = self._flight.heading_rad(row) + np.radians(degrees)
        rim = np.stack([np.cos(bearings), np.sin(bearings), 0.0 * bearings], -1) * reach_m[:, None]
        here_nea_m = self._flight.places_nea_m[row]
        return here_nea_m + np.stack([0.0 * rim, rim], axis=1)[told]

    def _draw_radar(self, name: str, radar: Radar) -> None:
        """The sphere in which it sees between the ground and the ceiling."""
        band = self.area.low_m, self.area.high_m
        ball = self.area.scene(ball_nea_m(radar, band, _BALL_POINTS))
        self._mesh(name, Mesh.grid(ball), _RADAR, opacity=0.15)
        north, east, altitude = radar.centre_nea_m
        top = np.array([north, east, min(altitude + radar.range_m, band[1])])
        self._label(f"{name}/label", radar.name, self.area.scene(top))

    def _draw_zone(self, name: str, zone: Zone) -> None:
        """Its walls up to the ceiling, their upper edge, and its name in the middle."""
        colour, what = (_KEEP_IN, "keep-in") if zone.keep_in else (_KEEP_OUT, "keep-out")
        walls = self.area.scene(walls_nea_m(zone, (self.area.low_m, self.area.high_m)))
        self._mesh(name, Mesh.grid(walls), colour, opacity=0.25)
        self._lines(f"{name}/rim", shapes.segments(walls[1]), colour, 2.0)
        middle = np.array([*outline_ne_m(zone).mean(axis=0), self.area.high_m])
        text = zone.name if what in zone.name else f"{what} {zone.name}".strip()
        self._label(f"{name}/label", text, self.area.scene(middle))

    def _draw_targets(self, targets_ne_m: tuple[tuple[float, float], ...]) -> None:
        for number, target_ne_m in enumerate(targets_ne_m, 1):
            name = f"/decided/target_{number}"
            foot = self.area.scene(np.array([*target_ne_m, self.area.low_m]))
            head = foot + np.array([0.0, 0.0, 0.14 * shapes.WIDTH])
            self._lines(name, np.array([[foot, head]]), _KEEP_OUT, 3.0)
            self._ball(f"{name}/head", head, 0.8, _KEEP_OUT)
            text = "target" if len(targets_ne_m) == 1 else f"target {number}"
            self._label(f"{name}/label", text, head + np.array([0.0, 0.0, 0.6]))

    def _draw_subpaths(self, decided: Decided) -> None:
        """The subpath that is flown, the next one, and what spans it."""
        leg, ready = decided.leg, decided.ready
        for name, plan, width in (("leg", leg, 6.0), ("next", ready, 3.0)):
            if plan is not None and (name == "leg" or plan is not leg):
                lengths_m = np.linspace(0.0, plan.subpath.length_m, _CURVE_POINTS)
                curve = self.area.scene(plan.subpath.points_nea_m(lengths_m))
                self._lines(f"/decided/{name}", shapes.segments(curve), _PATH, width)
        if ready is not None:
            control = self.area.scene(np.array(ready.control_nea_m))
            self._lines("/decided/control", shapes.segments(control), _PATH, 1.0)
            for number, point in enumerate(control):
                self._ball(f"/decided/control/{number}", point, 0.2, _WHITE)

    def _draw_asked(self, asked: PlanAsked, ready: PlanReady | None) -> None:
        """What the newest plan was asked for, its guide, and how far the terrain radar looked."""
        scan, start = (
            self.area.scene(np.array(each)) for each in (asked.scan_nea_m, asked.start_nea_m)
        )
        for name, place, colour, anchor in (
            ("p_scan", scan, _SCAN, "bottom-right"),
            ("p_prog", start, _PATH, "bottom-left"),
        ):
            self._ball(f"/decided/{name}", place, 0.3, colour)
            self._label(f"/decided/{name}/label", name, np.array([0.0, 0.0, 0.5]), anchor)
        if ready is not None and ready.plan_id == asked.plan_id:
            ahead = np.array([math.sin(ready.guide_rad), math.cos(ready.guide_rad), 0.0])
            arrow = np.array([[scan, scan + 9.0 * ahead]], dtype=np.float32)
            sizes: dict[str, Any] = {"shaft_radius": 0.05, "head_radius": 0.2, "head_length": 0.7}
            self._scene.add_arrows("/decided/guide", arrow, _GUIDE, **sizes)
        mission = self._flight.mission
        if mission.near is None:
            ring = circle_ne_m(asked.scan_nea_m[:2], mission.task.settings.scan_range_m)
            points = self.area.scene(np.insert(ring, 2, asked.scan_nea_m[2], axis=1))
            self._lines("/decided/reach", shapes.segments(points), _SCAN, 2.0)

    # --- nodes

    def _group(self, name: str) -> None:
        """An empty node to put others under."""
        self._scene.remove_by_name(name)
        self._scene.add_frame(name, show_axes=False)

    def _mesh(self, name: str, mesh: Mesh, colour: Rgb, **how: Any) -> viser.MeshHandle:
        how |= {"color": colour, "side": "double", **_NO_SHADOWS}
        return self._scene.add_mesh_simple(name, mesh.vertices, mesh.faces, **how)

    def _lines(
        self, name: str, pieces: FloatArray, colour: Rgb, width: float
    ) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(
            name, pieces.astype(np.float32), colour, thickness=width, thickness_units="screen"
        )

    def _ball(self, name: str, centre: FloatArray, radius: float, colour: Rgb) -> None:
        self._scene.add_icosphere(
            name, radius=radius, color=colour, position=centre, cast_shadow=False
        )

    def _label(
        self, name: str, text: str, place: FloatArray, anchor: Any = "bottom-center"
    ) -> None:
        self._scene.add_label(name, text, position=place, anchor=anchor, font_screen_scale=0.9)
