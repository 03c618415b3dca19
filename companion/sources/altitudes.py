"""The altitudes of a mission's targets, held against the ground that is known before take-off."""

from collections.abc import Iterator

import numpy as np

from companion.errors import InputError
from companion.mission.mission import Mission
from companion.sources.mission_schema import TargetTable
from companion.world.columns import distance_to_terrain_m

_MENTIONED_M = 1.0  # a smaller difference is worth no mention
_STEP_M = 5.0


def carried_on(altitudes_amsl_m: list[float | None]) -> tuple[float | None, ...]:
    """Each target's altitude, of one that has none that of the target before; () if none has."""
    carried: list[float | None] = []
    for altitude in altitudes_amsl_m:
        before = carried[-1] if carried else None
        carried.append(before if altitude is None else altitude)
    return tuple(carried) if carried and carried[-1] is not None else ()


def about_altitudes(mission: Mission, targets: list[TargetTable], where: str) -> Iterator[str]:
    """Where the targets' own altitudes are not flown, for a vehicle without a terrain radar.

    Raises InputError about a target that nothing of the band is high enough for, or whose ground
    is not known.
    """
    lowest_m, top_m = mission.task.band_amsl_m
    for number, table in enumerate(targets):
        if table.altitude_amsl_m is not None and table.altitude_amsl_m >= top_m:
            rule = f"no path lies higher than {top_m:g} m, the ceiling less the vehicle's errors"
            remedy = "Lower it, or raise altitude.ceiling_amsl_m."
            field = f"{where}: targets[{number}].altitude_amsl_m"
            raise InputError(field, table.altitude_amsl_m, rule, remedy)
    may_scan = mission.near is not None or mission.scanner_component_id is not None
    if mission.known is None or may_scan:
        return
    altitudes = mission.altitudes_amsl_m or (None,) * len(targets)
    places = zip(mission.targets_ne_m, altitudes, targets, strict=False)
    for number, (place, wanted_m, table) in enumerate(places):
        field = f"{where}: targets[{number}]" + (f" ({table.name})" if table.name else "")
        least_m = lowest_m if wanted_m is None else max(wanted_m, lowest_m)
        flown_m = _clear_from_m(mission, place, least_m)
        if flown_m is None:
            top_m = mission.task.limits.ceiling_amsl_m
            rule = f"the ground there is not known, or too high for the ceiling, {top_m:g} m AMSL"
            remedy = "Move it, or correct [terrain] or altitude.ceiling_amsl_m."
            raise InputError(field, list(place), rule, remedy)
        if wanted_m is not None and flown_m - wanted_m > _MENTIONED_M:
            yield (
                f"{table.name or f'target {number + 1}'} is planned at {wanted_m:g} m AMSL and "
                f"flown at {flown_m:.0f} m: below that d_s and the vehicle's errors are not kept"
            )


def _clear_from_m(mission: Mission, place: tuple[float, float], least_m: float) -> float | None:
    """The lowest altitude from this one on that is clear of the ground; None: none in the band."""
    assert mission.known is not None
    top_m, required_m = mission.task.band_amsl_m[1], mission.task.required_clearance_m
    for up_m in np.arange(min(least_m, top_m), top_m, _STEP_M):
        at = np.array([*place, up_m])
        if distance_to_terrain_m(mission.known, at, required_m) >= required_m - 1e-6:
            return float(up_m)
    return None
