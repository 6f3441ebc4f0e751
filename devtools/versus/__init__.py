"""The twin beside other methods on the same inputs: `python -m devtools.versus`, docs/versus.md."""
