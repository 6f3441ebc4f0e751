"""Geometry: kinematics, tool path, poses of bodies, polylines, s-curves."""
