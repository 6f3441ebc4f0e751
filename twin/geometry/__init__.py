"""Geometry: kinematics, tool paths, body poses, polylines, s-curves."""
