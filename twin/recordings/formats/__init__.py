"""One reader a file format; `by_ending` picks it by the ending of the file."""
