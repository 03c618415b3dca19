"""A recorded flight for other people's programs: Google Earth, QGIS, tables, QGroundControl."""
