"""Geometry: kinematics, tool paths, body poses, s-curves."""
