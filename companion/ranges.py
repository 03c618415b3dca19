"""What a number may be by itself, said once: in the type of the field that holds it.

Mission files (`sources`) are held to it.  No number may be infinite or none at all.
"""

from typing import Annotated

from annotated_types import Ge, Gt, Le

Positive = Annotated[float, Gt(0.0), Le(1e6)]
NotNegative = Annotated[float, Ge(0.0), Le(1e6)]
Horizontal = Annotated[float, Ge(-1e6), Le(1e6)]
"""North or east of the origin, metres."""
Altitude = Annotated[float, Ge(-500.0), Le(50_000.0)]
Spread = Annotated[float, Ge(0.01), Le(1e6)]
"""Places are divided by it and squared: less would make them infinite."""
Latitude = Annotated[float, Ge(-90.0), Le(90.0)]
Longitude = Annotated[float, Ge(-180.0), Le(180.0)]
