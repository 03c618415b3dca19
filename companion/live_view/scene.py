"""The scene: what a flight was, knew and wanted at a moment, in three dimensions."""

import hashlib
import math
from collections.abc import Sequence
from typing import Any, Final, final

import numpy as np
import viser

from companion.geodesy import FloatArray
from companion.live_view import shapes
from companion.live_view.ground import Ground
from companion.live_view.recording import SECTORS
from companion.live_view.shapes import Area, Mesh, Scale
from companion.mission.journal import PlanReady
from companion.path.subpath import Subpath
from companion.telemetry.export.shapes import circle_ne_m, outline_ne_m
from companion.telemetry.flight import Decided, Flight
from companion.views.words import metres
from companion.world.zones import Zone

Rgb = tuple[int, int, int]
PATH: Final[Rgb] = (0, 80, 181)
RADAR: Final[Rgb] = (194, 56, 155)
KEEP_OUT: Final[Rgb] = (232, 89, 12)
VEHICLE: Final[Rgb] = (255, 214, 10)
_TRACK: Final[Rgb] = (20, 20, 20)
_GUIDE: Final[Rgb] = (0, 140, 110)
_SCAN: Final[Rgb] = (60, 150, 230)
_UNKNOWN: Final[Rgb] = (196, 200, 205)
_GUESSED: Final[Rgb] = (110, 140, 175)
_KEEP_IN: Final[Rgb] = (120, 120, 120)
_TRACK_POINTS: Final = 1500
_CURVE_POINTS: Final = 80


@final
class Scene:
    """Draws one flight; only what has changed is sent again."""

    def __init__(self, server: viser.ViserServer, flight: Flight) -> None:
        self._server, self._scene, self._flight = server, server.scene, flight
        self.area = Area.of(flight)
        self.scale = Scale.of(self.area)
        self._ground: Ground | None = None
        self._tiles: dict[tuple[int, int], bytes] = {}
        self._drawn: dict[str, Any] = {}
        """What each part was drawn from last."""
        self._light_up()
        for name in ("/threats", "/scan", "/proven"):
            self._group(name)

    def _light_up(self) -> None:
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
        self._mesh("/unknown", shapes.plate(self.scale, self.area), _UNKNOWN)
        step_m = shapes.grid_step_m(self.area)
        lines = shapes.grid_lines(self.scale, self.area, step_m)
        self._lines("/grid", lines, (168, 172, 178), 1.0)
        corner = np.array([self.area.north_m[0], self.area.east_m[0], self.scale.base_amsl_m])
        self._label("/legend/grid", f"grid {metres(step_m)}", self.scale.scene(corner), "top-left")
        north = np.array([self.area.north_m[1], sum(self.area.east_m) / 2, self.scale.base_amsl_m])
        self._label("/legend/north", "N", self.scale.scene(north), "bottom-center")

    # --- the moment

    def show(self, time_s: float, heading_rad: float) -> FloatArray:
        """Draw the flight as it was; where the vehicle is in the scene.  -> (3,)."""
        flight = self._flight
        row, decided = flight.row_at(time_s), flight.decided_at(time_s)
        here = self.scale.scene(flight.places_nea_m[row])
        with self._server.atomic():
            self._show_vehicle(here, heading_rad)
            self._show_track(row)
            self._show_threats(flight.zones_of(decided))
            self._show_targets(decided.targets_ne_m)
            self._show_plan(decided)
            self._show_sight(time_s, row, decided, heading_rad)
        return here

    def show_ground(self, ground: Ground) -> None:
        """Draw the terrain as it is known: the pieces that differ."""
        if ground is self._ground:
            return
        self._ground = ground
        top_m = self._top_m()
        present = set()
        with self._server.atomic():
            for place, key, mesh in shapes.proven_tiles(ground, self.scale, top_m):
                digest = hashlib.blake2b(key, digest_size=16).digest()
                present.add(place)
                if self._tiles.get(place) != digest:
                    self._tiles[place] = digest
                    self._coloured(f"/proven/{place[0]}_{place[1]}", mesh)
            for place in self._tiles.keys() - present:
                del self._tiles[place]
                self._remove(f"/proven/{place[0]}_{place[1]}")
            guessed = shapes.guessed_mesh(ground, self.scale)
            if guessed is None:
                self._remove("/guessed")
            else:
                self._mesh("/guessed", guessed, _GUESSED, opacity=0.38)

    def _top_m(self) -> float:
        low_m, high_m = self.scale.base_amsl_m, self.area.high_m
        return high_m + 0.1 * (high_m - low_m)

    def _show_vehicle(self, here: FloatArray, heading_rad: float) -> None:
        if "vehicle" not in self._drawn:
            mesh = shapes.dart()
            self._drawn["vehicle"] = self._scene.add_mesh_simple(
                "/vehicle",
                mesh.vertices * 1.8,
                mesh.faces,
                color=VEHICLE,
                flat_shading=True,
                side="double",
                cast_shadow=False,
            )
            self._drawn["drop"] = self._scene.add_line_segments(
                "/drop", np.zeros((1, 2, 3)), VEHICLE, thickness=1.5, thickness_units="screen"
            )
        turn = math.pi / 2.0 - heading_rad  # clockwise from north -> anticlockwise from x
        node = self._drawn["vehicle"]
        node.wxyz, node.position = (math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)), here
        self._drawn["drop"].points = np.array([[here, [*here[:2], 0.0]]], dtype=np.float32)

    def _show_track(self, row: int) -> None:
        rows = np.unique(np.linspace(0, row, min(row + 1, _TRACK_POINTS)).astype(np.intp))
        if len(rows) > 1:
            points = self.scale.scene(self._flight.places_nea_m[rows])
            self._lines("/track", shapes.segments(points), _TRACK, 2.5)
        else:
            self._remove("/track")

    def _show_threats(self, zones: Sequence[Zone]) -> None:
        flight = self._flight
        radars = flight.mission.task.radars if flight.has_mission else ()
        if self._same("threats", (radars, tuple(zones))):
            return
        self._group("/threats")
        band = self.scale.base_amsl_m, self.area.high_m
        for number, radar in enumerate(radars):
            name = f"/threats/radar_{number}"
            self._mesh(name, shapes.radar_mesh(radar, self.scale, band), RADAR, opacity=0.15)
            north, east, altitude = radar.centre_nea_m
            top = np.array([north, east, min(altitude + radar.range_m, band[1])])
            self._label(f"{name}/label", radar.name, self.scale.scene(top), "bottom-center")
        for number, zone in enumerate(zones):
            name = f"/threats/zone_{number}"
            colour = _KEEP_IN if zone.keep_in else KEEP_OUT
            self._mesh(name, shapes.zone_mesh(zone, self.scale, band), colour, opacity=0.25)
            outline = outline_ne_m(zone)
            top = self.scale.scene(np.array([*outline.mean(axis=0), band[1]]))
            what = "keep-in" if zone.keep_in else "keep-out"
            text = zone.name if what in zone.name else f"{what} {zone.name}".strip()
            self._label(f"{name}/label", text, top, "bottom-center")
            rim = np.insert(outline, 2, band[1], axis=1)
            self._lines(f"{name}/rim", shapes.segments(self.scale.scene(rim)), colour, 2.0)

    def _show_targets(self, targets_ne_m: tuple[tuple[float, float], ...]) -> None:
        if self._same("targets", targets_ne_m):
            return
        self._group("/targets")
        for number, (north_m, east_m) in enumerate(targets_ne_m, 1):
            foot = self.scale.scene(np.array([north_m, east_m, self.scale.base_amsl_m]))
            mast = np.array([[foot, [*foot[:2], foot[2] + 0.14 * shapes.WIDTH]]])
            self._lines(f"/targets/{number}", mast, KEEP_OUT, 3.0)
            self._ball(f"/targets/{number}/head", mast[0, 1], 0.8, KEEP_OUT)
            text = "target" if len(targets_ne_m) == 1 else f"target {number}"
            self._label(f"/targets/{number}/label", text, mast[0, 1] + [0, 0, 0.6], "bottom-center")

    # --- what was planned

    def _show_plan(self, decided: Decided) -> None:
        leg, ready, asked = decided.leg, decided.ready, decided.asked
        if self._same("plan", (leg, ready, asked)):
            return
        self._group("/plan")
        if leg is not None:
            self._curve("/plan/leg", leg, 6.0)
        if ready is not None and ready is not leg:
            self._curve("/plan/next", ready, 3.0)
        shown = ready or leg
        if shown is not None:
            control = self.scale.scene(np.array(shown.control_nea_m))
            self._lines("/plan/control", shapes.segments(control), PATH, 1.0)
            for number, point in enumerate(control):
                self._ball(f"/plan/control/{number}", point, 0.2, (255, 255, 255))
        if asked is not None:
            scan, start = (
                self.scale.scene(np.array(each)) for each in (asked.scan_nea_m, asked.start_nea_m)
            )
            self._ball("/plan/p_scan", scan, 0.3, _SCAN)
            self._ball("/plan/p_prog", start, 0.3, PATH)
            self._label("/plan/p_scan/label", "p_scan", np.array([0, 0, 0.5]), "bottom-right")
            self._label("/plan/p_prog/label", "p_prog", np.array([0, 0, 0.5]), "bottom-left")
            if shown is not None and shown.plan_id == asked.plan_id:
                tip = scan + 9.0 * np.array(
                    [math.sin(shown.guide_rad), math.cos(shown.guide_rad), 0]
                )
                self._scene.add_arrows(
                    "/plan/guide",
                    np.array([[scan, tip]], dtype=np.float32),
                    _GUIDE,
                    shaft_radius=0.05,
                    head_radius=0.2,
                    head_length=0.7,
                )

    def _points(self, subpath: Subpath) -> FloatArray:
        """Some points of a curve.  -> (S, 3)."""
        lengths_m = np.linspace(0.0, subpath.length_m, _CURVE_POINTS)
        return self.scale.scene(subpath.points_nea_m(lengths_m))

    def _curve(self, name: str, plan: PlanReady, width: float) -> None:
        self._lines(name, shapes.segments(self._points(plan.subpath)), PATH, width)

    # --- what was seen

    def _show_sight(self, time_s: float, row: int, decided: Decided, heading_rad: float) -> None:
        flight = self._flight
        swept = flight.newest(SECTORS, time_s)
        if swept is not None and swept[0] < 1.0:
            here = flight.places_nea_m[row]
            self._mesh("/scan/fan", self._fan(here, swept[1], heading_rad), _SCAN, opacity=0.22)
        else:
            self._remove("/scan/fan")
        asked = decided.asked
        if asked is None or flight.mission.near is not None:
            self._remove("/scan/reach")
        elif not self._same("reach", asked.scan_nea_m):
            north, east, altitude = asked.scan_nea_m
            ring = circle_ne_m((north, east), flight.mission.task.settings.scan_range_m)
            points = self.scale.scene(np.insert(ring, 2, altitude, axis=1))
            self._lines("/scan/reach", shapes.segments(points), _SCAN, 2.0)

    def _fan(self, here_nea_m: FloatArray, message: Any, heading_rad: float) -> Mesh:
        """What a horizontal lidar passed over: a fan of its sectors, in centimetres on the wire."""
        width_rad = math.radians(message.increment_f or message.increment)
        first_rad = heading_rad + math.radians(message.angle_offset)
        reach_m = np.array(message.distances, dtype=np.float64) / 100.0
        told = np.array(message.distances) != 65535
        reach_m = np.where(told, np.minimum(reach_m, message.max_distance / 100.0), 0.0)
        bearings = first_rad + (np.arange(len(reach_m))[:, None] + [-0.5, 0.5]) * width_rad
        rim = np.stack([np.cos(bearings), np.sin(bearings), 0.0 * bearings], -1)
        rim = (rim * reach_m[:, None, None] + here_nea_m).reshape(-1, 3)
        points = np.concatenate([here_nea_m[None], rim])
        first = 1 + 2 * np.flatnonzero(told)
        faces = np.stack([0 * first, first, first + 1], axis=-1)
        return Mesh(self.scale.scene(points), faces.astype(np.uint32))

    # --- nodes

    def _same(self, part: str, source: Any) -> bool:
        """Whether a part was drawn from just this."""
        if part in self._drawn and self._drawn[part] == source:
            return True
        self._drawn[part] = source
        return False

    def _remove(self, name: str) -> None:
        self._scene.remove_by_name(name)
        for each in [key for key in self._drawn if key.startswith(f"lines {name}")]:
            del self._drawn[each]

    def _group(self, name: str) -> None:
        """An empty node to put others under."""
        self._remove(name)
        self._scene.add_frame(name, show_axes=False)

    def _mesh(self, name: str, mesh: Mesh, colour: Rgb, opacity: float | None = None) -> None:
        self._scene.add_mesh_simple(
            name,
            mesh.vertices,
            mesh.faces,
            color=colour,
            opacity=opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _coloured(self, name: str, mesh: Mesh) -> None:
        self._scene.add_glb(name, shapes.painted_glb(mesh), cast_shadow=False, receive_shadow=False)

    def _lines(self, name: str, pieces: FloatArray, colour: Rgb, width: float) -> None:
        pieces = pieces.astype(np.float32)
        before = self._drawn.get(f"lines {name}")
        if before is not None and before.points.shape == pieces.shape:
            if not np.array_equal(before.points, pieces):
                before.points = pieces
            return
        self._drawn[f"lines {name}"] = self._scene.add_line_segments(
            name, pieces, colour, thickness=width, thickness_units="screen"
        )

    def _ball(self, name: str, centre: FloatArray, radius: float, colour: Rgb) -> None:
        self._scene.add_icosphere(
            name, radius=radius, color=colour, position=centre, cast_shadow=False
        )

    def _label(self, name: str, text: str, place: FloatArray, anchor: Any) -> None:
        self._scene.add_label(name, text, position=place, anchor=anchor, font_screen_scale=0.9)
