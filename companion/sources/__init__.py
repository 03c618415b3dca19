"""Missions and worlds from where users have them: TOML, .plan, GeoJSON, elevation."""
