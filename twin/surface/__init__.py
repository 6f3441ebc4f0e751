"""The cut surface: material removal along the followed tool path.

tool path (twin.geometry.tool_path) -> steps -> removal along rays -> metrology -> pictures, files
"""
