"""The cut surface: what the followed tool path leaves of the part.

tool path (twin.geometry.tool_path) -> steps -> removal along rays or dexels -> metrology -> pictures, files
"""
