"""One reader per file format; `by_content` selects it by the first bytes of the file."""
