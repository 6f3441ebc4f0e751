"""One reader per file format; `by_ending` selects it by the file's ending."""
