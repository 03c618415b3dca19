"""The arguments of a session as plain values: the first of its inputs."""

from typing import Annotated, Any, final

import msgspec
from msgspec import Meta

from companion.mission.checkpoint import Values
from companion.mission.decisions import Context
from companion.mission.mission import Mission
from companion.world.known_map import KnownMap, digest_of, packed_map

Resume = tuple[Values, KnownMap | None]
"""Data to resume from: the checkpoint, and the map if it can be read."""


SystemId = Annotated[int, Meta(ge=1, le=255)]
"""Of a MAVLink vehicle."""


@final
class Start(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The arguments of a session besides the mission, which is stored elsewhere."""

    companion: str
    """Version."""
    mission: str
    """Name."""
    profile: str
    system_id: SystemId | None
    """Of the vehicle, if that is known in advance."""
    seed: Annotated[int, Meta(ge=0)]
    lockstep: bool
    shadow: bool
    resume: Values | None
    known: bytes | None
    """The map that is resumed with (`packed_map`)."""
    go: bool = True
    """Whether somebody had said go beforehand (--start).  Older recordings asked nobody."""
    terrain: str
    """Of the terrain that the mission knows in advance (`digest_of`); "": it knows none.

    It may stand in a file outside of the run folder.
    """

    @staticmethod
    def of(context: Context, resume: Resume | None, *, version: str) -> "Start":
        """Of a session that begins."""
        values, known = (None, None) if resume is None else resume
        mission = context.mission
        return Start(
            companion=version,
            mission=mission.name,
            profile=mission.task.settings.profile.name,
            system_id=mission.system_id,
            seed=context.seed,
            lockstep=context.lockstep,
            shadow=context.shadow,
            go=context.go,
            resume=values,
            known=None if known is None else packed_map(known),
            terrain=terrain_of(mission),
        )

    def values(self) -> dict[str, Any]:
        """For a file."""
        return msgspec.structs.asdict(self)


def terrain_of(mission: Mission) -> str:
    """Digest of the terrain that a mission knows in advance; "": none."""
    return "" if mission.known is None else digest_of(mission.known)
